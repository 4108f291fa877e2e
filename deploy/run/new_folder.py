"""Folders for results: new ones, and no two commands in one at a time."""

from __future__ import annotations

import fcntl
import os
import re
import shutil
import time
from itertools import chain, count
from pathlib import Path

from bus_schema.configuration import shortened
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
    lock = FolderLock(path)
    try:
        _clear(path, overwrite=overwrite)
    finally:
        lock.close()
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


def _clear(path: Path, *, overwrite: bool) -> None:
    """Make sure that a folder holds no results."""
    found = next((name for name in _RESULTS if (path / name).exists()), None)
    if found is not None and not overwrite:
        raise ScenarioError(
            f"--out {path}: holds results ({found}): must be a folder without, or give --overwrite"
        )
    if overwrite:
        _remove_files(path)


def holds_results(path: Path) -> bool:
    """Whether there is a folder with results of ours."""
    return any((path / name).exists() for name in _RESULTS)


def remove_results(path: Path) -> None:
    """Remove what commands left in a folder, and the folder where nothing else is in it.

    Raises:
        ScenarioError: another command is writing there.
    """
    lock = FolderLock(path)
    try:
        for inner in [inner for inner in path.iterdir() if inner.is_dir()]:
            if not inner.is_symlink() and holds_results(inner):  # one law of a comparison
                remove_results(inner)
        _remove_files(path)
        if not any(path.iterdir()):
            path.rmdir()
    finally:
        lock.close()


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
