"""Index of folders of results: content and tags of each."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Any

from bus_schema.recording.atomic_files import write_json
from deploy.reports.kinds import kind_of
from deploy.run.new_folder import holds_results
from deploy.run.run_folder import read_json, read_manifest, read_summary
from deploy.scenario.yaml_files import ScenarioError

_TAGS = "tags.json"
_TAG = re.compile(r"[A-Za-z0-9][A-Za-z0-9_.-]{0,99}")


@dataclass(frozen=True)
class IndexedResults:
    """A folder of results.

    Attributes:
        path: the folder.
        kind: ``run``, ``comparison``, ``sweep``, ``margin`` or ``robustness``.
        what: name of the scenario or study, and the law of a run.
        started: start time; None if unknown.
        result: the verdict on a run; of several, ``complete`` or the worst verdict except lost.
        tags: in alphabetical order.
    """

    path: Path
    kind: str
    what: str
    started: datetime | None
    result: str
    tags: list[str]

    @property
    def size_bytes(self) -> int:
        return sum(file.stat().st_size for file in self.path.rglob("*") if file.is_file())


def results_in(folder: Path) -> list[IndexedResults]:
    """Return the results in a folder, the oldest first.

    Raises:
        ScenarioError: there is no such folder.
    """
    if not folder.is_dir():
        raise ScenarioError(f"{folder}: no such folder")
    found = [_looked_at(path) for path in _result_folders(folder)]
    return sorted(found, key=lambda each: (_seconds(each.started), each.path))


def tag(path: Path, add: Sequence[str], remove: Sequence[str]) -> list[str]:
    """Change the tags of a folder of results; return its new tags.

    Raises:
        ScenarioError: it holds no results, or a tag is invalid.
    """
    if not holds_results(path):
        raise ScenarioError(f"{path}: holds no results")
    for each in add:
        if not _TAG.fullmatch(each):
            allowed = "must be letters, digits, and after the first character also _.-"
            raise ScenarioError(f"tag {each[:100]!r}: {allowed}")
    tags = sorted({*tags_of(path), *add} - set(remove))
    write_json(path / _TAGS, {"tags": tags})
    return tags


def tags_of(path: Path) -> list[str]:
    """Return the tags of a folder of results."""
    stored = read_json(path / _TAGS).get("tags")
    return [each for each in stored if isinstance(each, str)] if isinstance(stored, list) else []


def _result_folders(folder: Path) -> Iterator[Path]:
    for path in sorted(folder.iterdir()):
        if path.is_dir() and not path.is_symlink() and holds_results(path):
            yield path


def _looked_at(path: Path) -> IndexedResults:
    summary, manifest = read_summary(path), read_manifest(path)
    kind = kind_of(summary)
    names = [summary.get("name") or summary.get("scenario") or _scenario_of(manifest)]
    if kind.is_run:
        names.append(summary.get("law"))
    return IndexedResults(
        path,
        kind.name,
        " ".join(str(name) for name in names if name),
        _time(manifest.get("started")),
        kind.listed(summary),
        tags_of(path),
    )


def _scenario_of(manifest: dict[str, Any]) -> Any:
    scenario = manifest.get("scenario")
    return scenario.get("name") if isinstance(scenario, dict) else None


def _time(text: Any) -> datetime | None:
    try:
        return datetime.strptime(str(text), "%Y-%m-%dT%H:%M:%S%z")
    except ValueError:
        return None


def _seconds(time: datetime | None) -> float:
    return 0.0 if time is None else time.timestamp()
