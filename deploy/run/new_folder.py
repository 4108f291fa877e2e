"""Folders for results: new ones, locks between commands, and hints for missing recordings."""

from __future__ import annotations

import fcntl
import json
import os
import re
import shutil
import tempfile
import time
from collections.abc import Callable
from itertools import chain, count
from pathlib import Path

from bus_schema.errors import did_you_mean
from bus_schema.foreign_text import shortened
from deploy.scenario.effective import is_copy
from deploy.scenario.yaml_files import ScenarioError

_RESULTS = (
    "controller_stdout.log", "controller_stderr.log",
    "run.mcap", "run.partial.mcap", "summary.json", "manifest.json", "report.html", "fault.json",
    "study.yaml", "comparison.parquet", "sweep.parquet", "margin.parquet", "robustness.parquet",
    "tune.parquet", "benchmark.parquet",
    "provenance.json",
)  # fmt: skip
"""A folder with any of these holds results."""
_MORE = re.compile(
    r"(controller|plant|recorder|relay|viewer)_output\.log"
    r"|run-\d+(\.partial)?\.mcap|can(-\d+)?\.log|table\.md|scenario\.yaml|tags\.json"
    r"|worst_pattern-\d+-\w+\.csv"
    r"|\w+\.partial\.(json|html|parquet|md|yaml)|plotly\.min(\.partial)?\.js"
)
"""Other files that commands write there."""
_LISTED = re.compile(r"[\w.-]+\.(urdf|yaml|csv)")
"""Files that a summary may list as its own; elsewhere, files of these names are a user's."""
_FOLDERS = ("rows", "scenarios", "base", "export")
"""Folders of a study, and of `export`."""
_SHOWN = 5
_ROOM_BYTES = 10_000_000
"""Free space, in bytes, without which old results stay: for a report and a short recording."""


class FolderLock:
    """Keeps other commands from writing to a folder, until it is closed or the process ends.

    Args:
        path: the folder.

    Raises:
        ScenarioError: another command holds the lock.
    """

    def __init__(self, path: Path) -> None:
        self._descriptor: int | None = None
        self._descriptor = os.open(path, os.O_RDONLY | os.O_DIRECTORY)
        try:
            fcntl.flock(self._descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError as error:
            self.close()
            raise ScenarioError(f"{path}: another command is writing there") from error
        except OSError:  # a file system without locks
            self.close()

    def close(self) -> None:
        if self._descriptor is not None:
            os.close(self._descriptor)
            self._descriptor = None

    def __enter__(self) -> FolderLock:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def __del__(self) -> None:
        self.close()


def new_folder(name: str, out: Path | None, *, overwrite: bool = False) -> Path:
    """Create and return a folder for new results, by default ``runs/<name>-<time>``.

    Args:
        name: name of the scenario or study.
        out: the requested folder.
        overwrite: remove existing results, and nothing else.

    Raises:
        ScenarioError: it cannot be created or written to, another command writes there, it holds
            results and `overwrite` is false, or the disk is full.
    """
    if overwrite and out is None:
        raise ScenarioError("--overwrite: needs --out, because the default folder is always new")
    path = resolved_out(out or _unused(f"runs/{name}-{time.strftime('%Y%m%d-%H%M%S')}"))
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        reason = error.strerror
        raise ScenarioError(f"--out {shortened(str(path))}: cannot be created: {reason}") from error
    if not os.access(path, os.W_OK):
        raise ScenarioError(f"--out {path}: is not writable")
    with FolderLock(path):
        found = next((name for name in _RESULTS if (path / name).exists()), None)
        if overwrite:
            if found is not None:
                _check_room(path)
                _remove_files(path)
        elif found is not None:
            allowed = "use another folder, or --overwrite"
            raise ScenarioError(f"--out {path}: holds results ({found}): {allowed}")
    return path


def resolved_out(path: Path) -> Path:
    """Return the absolute path of a folder for results, which need not exist.

    Raises:
        ScenarioError: its symbolic links are circular.
    """
    try:
        return path.resolve()
    except (OSError, RuntimeError, ValueError) as error:
        raise ScenarioError(f"--out {shortened(str(path))}: cannot be created: {error}") from error


def holds_results(path: Path) -> bool:
    """Whether a folder holds results of ours."""
    return any((path / name).exists() for name in _RESULTS)


def remove_results(path: Path) -> None:
    """Remove the results in a folder, and the folder itself if it is then empty.

    Raises:
        ScenarioError: another command is writing there.
    """
    with FolderLock(path):
        for inner in [inner for inner in path.iterdir() if inner.is_dir()]:
            if not inner.is_symlink() and holds_results(inner):  # one law of a comparison
                remove_results(inner)
        _remove_files(path)
        if not any(path.iterdir()):
            path.rmdir()


def _check_room(path: Path) -> None:
    """Refuse to remove results where new ones could not be written."""
    try:
        with tempfile.TemporaryFile(dir=path) as file:
            os.posix_fallocate(file.fileno(), 0, _ROOM_BYTES)
    except OSError as error:
        raise ScenarioError(
            f"--out {path}: the old results are kept, because there is no room for"
            f" {_ROOM_BYTES // 10**6} MB of new ones: {error.strerror}"
        ) from error


def _remove_files(path: Path) -> None:
    own = _own_files(path)
    for file in path.iterdir():
        is_result = file.name in _RESULTS or _MORE.fullmatch(file.name) or is_copy(file)
        if is_result or file.name in own:
            file.unlink()
    for name in _FOLDERS:
        shutil.rmtree(path / name, ignore_errors=True)


def _own_files(path: Path) -> set[str]:
    """Return the files that a summary lists as written beside it."""
    try:
        listed = json.loads((path / "summary.json").read_text(encoding="utf-8"))["files"]
        return {name for name in listed if _LISTED.fullmatch(name)}
    except (OSError, ValueError, TypeError, KeyError):
        return set()


def _unused(name: str) -> Path:
    """Return a path of that name, with a number appended if it exists already."""
    candidates = chain([name], (f"{name}-{number}" for number in count(2)))
    return next(path for path in map(Path, candidates) if not path.exists())


def missing_recording(path: Path, kind: str) -> str:
    """Explain that a path holds no run, and suggest paths that do.

    Args:
        path: a folder without ``run.mcap``, or a path that does not exist.
        kind: kind of the results in that folder, from its summary; empty without one.
    """
    if not path.exists():
        return f"{path}: has no run.mcap: no such folder or file{_others(path)}"
    if not kind and (path / "study.yaml").is_file():  # it was not finished
        kind = "study"
    recorded = _folders(path, lambda inner: (inner / "run.mcap").is_file())
    runs = f", with runs in {_listed(recorded)}" if recorded else ""
    report = path / "report.html"
    shown = report if report.is_file() else f"funnel-hil report {path}"
    others = f", because it is not a run but has results of kind {kind}{runs}; {shown} shows them"
    return f"{path}: has no run.mcap" + others * (kind not in {"", "run"})


def _others(path: Path) -> str:
    """Suggest runs near a path, as `funnel-hil runs list` shows them."""
    found = _folders(path.parent, holds_results)
    if not found:
        return "; funnel-hil runs list shows the results in runs"
    meant = did_you_mean(path.name, [each.name for each in found])
    return f"; funnel-hil runs list {path.parent} shows {_listed(found)}{meant}"


def _folders(folder: Path, are_asked_for: Callable[[Path], bool]) -> list[Path]:
    try:
        return sorted(inner for inner in folder.iterdir() if are_asked_for(inner))
    except OSError:  # it does not exist, or cannot be read
        return []


def _listed(folders: list[Path]) -> str:
    more = f" and {len(folders) - _SHOWN} more" if len(folders) > _SHOWN else ""
    return ", ".join(map(str, folders[:_SHOWN])) + more
