"""Why there is no recording where one was looked for, and where there is one."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from bus_schema.errors import did_you_mean
from deploy.run.new_folder import holds_results

_SHOWN = 5
_KINDS = {"margin": "study of margins", "robustness": "study of robustness"}


def missing_recording(path: Path, kind: str) -> str:
    """What to tell somebody who gave a path for that of a run.

    Args:
        path: a folder without ``run.mcap``, or nothing at all.
        kind: of the results in that folder, as its summary has it; empty where there is none.
    """
    if not path.exists():
        return f"{path}: holds no run.mcap: no such folder or file{_others(path)}"
    if not kind and (path / "study.yaml").is_file():  # it has come to no end
        kind = "study"
    if kind in {"", "run"}:
        return f"{path}: holds no run.mcap"
    recorded = _folders(path, lambda inner: (inner / "run.mcap").is_file())
    runs = f", with runs in {_listed(recorded)}" if recorded else ""
    return (
        f"{path}: holds no run.mcap, as it is no run but a {_KINDS.get(kind, kind)}{runs};"
        f" funnel-hil report {path} shows it"
    )


def _others(path: Path) -> str:
    """What `funnel-hil runs list` shows beside a path, and which of it may have been meant."""
    found = _folders(path.parent, holds_results)
    if not found:
        return "; funnel-hil runs list shows what lies in runs"
    meant = did_you_mean(path.name, [each.name for each in found])
    return f"; funnel-hil runs list {path.parent} shows {_listed(found)}{meant}"


def _folders(folder: Path, are_asked_for: Callable[[Path], bool]) -> list[Path]:
    try:
        return sorted(inner for inner in folder.iterdir() if are_asked_for(inner))
    except OSError:  # it is not there, or nobody may look into it
        return []


def _listed(folders: list[Path]) -> str:
    more = f" and {len(folders) - _SHOWN} more" if len(folders) > _SHOWN else ""
    return ", ".join(map(str, folders[:_SHOWN])) + more
