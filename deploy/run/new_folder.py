"""Folders for results: new ones, no two commands in one at a time, and missing recordings."""

from __future__ import annotations

import fcntl
import os
import re
import shutil
import time
from collections.abc import Callable
from itertools import chain, count
from pathlib import Path

from bus_schema.configuration import shortened
from bus_schema.errors import did_you_mean
from deploy.scenario.effective import is_copy
from deploy.scenario.yaml_files import ScenarioError

_RESULTS = (
    "controller_stdout.log", "controller_stderr.log",
    "run.mcap", "run.partial.mcap", "summary.json", "manifest.json", "report.html", "fault.json",
    "study.yaml", "comparison.parquet", "sweep.parquet", "margin.parquet", "robustness.parquet",
)  # fmt: skip
"""By any of these a folder holds results."""
_MORE = re.compile(
    r"(controller|plant|recorder|relay|viewer)_output\.log"
    r"|run-\d+(\.partial)?\.mcap|can(-\d+)?\.log|table\.md|scenario\.yaml|tags\.json"
    r"|\w+\.partial\.(json|html|parquet|md|yaml)|plotly\.min(\.partial)?\.js"
)
"""What else commands write there."""
_FOLDERS = ("rows", "scenarios", "base", "export")
"""Of a study, and what `export` writes."""
_SHOWN = 5
_KINDS = {"margin": "study of margins", "robustness": "study of robustness"}


class FolderLock:
    """Keeps other commands from writing to a folder, until it is closed or the process ends.

    Args:
        path: the folder.

    Raises:
        ScenarioError: another command has it.
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
    """A folder for new results, by default ``runs/<name>-<time>``.

    Args:
        name: of what is run.
        out: the folder asked for.
        overwrite: remove results that are there, and nothing else.

    Raises:
        ScenarioError: it cannot be created or written to, another command writes there, or it holds
            results that are not to be overwritten.
    """
    if overwrite and out is None:
        raise ScenarioError("--overwrite: must come with --out; another folder is always a new one")
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
            _remove_files(path)
        elif found is not None:
            allowed = "must be a folder without, or give --overwrite"
            raise ScenarioError(f"--out {path}: holds results ({found}): {allowed}")
    return path


def resolved_out(path: Path) -> Path:
    """The absolute path of a folder for results, which may not be there yet.

    Raises:
        ScenarioError: its symbolic links lead nowhere.
    """
    try:
        return path.resolve()
    except (OSError, RuntimeError, ValueError) as error:
        raise ScenarioError(f"--out {shortened(str(path))}: cannot be created: {error}") from error


def holds_results(path: Path) -> bool:
    """Whether there is a folder with results of ours."""
    return any((path / name).exists() for name in _RESULTS)


def remove_results(path: Path) -> None:
    """Remove what commands left in a folder, and the folder where nothing else is in it.

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


def _remove_files(path: Path) -> None:
    for file in path.iterdir():
        if file.name in _RESULTS or _MORE.fullmatch(file.name) or is_copy(file):
            file.unlink()
    for name in _FOLDERS:
        shutil.rmtree(path / name, ignore_errors=True)


def _unused(name: str) -> Path:
    """A path of that name, with a number behind it where there is one already."""
    candidates = chain([name], (f"{name}-{number}" for number in count(2)))
    return next(path for path in map(Path, candidates) if not path.exists())


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
