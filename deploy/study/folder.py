"""What a study leaves, and goes on from: its definition, its rows, and the scenario of every point.

Rows are written in parts soon after their runs are done, and put together in order at the end. A
part appears as a whole or not at all, so whenever a study is killed, what lies there can be used.
"""

from __future__ import annotations

import fcntl
import hashlib
import json
import time
from collections.abc import Sequence
from pathlib import Path
from typing import IO, Any

import yaml

from bus_schema.recording.atomic_files import write_whole
from deploy.runs.run_folder import RunFolder, RunFolderError, provenance
from deploy.runs.run_rows import Row, read_rows, write_rows
from deploy.scenario.scenario import Setup, load_setup
from deploy.scenario.scenario_text import effective_scenario
from deploy.scenario.yaml_files import ScenarioError
from deploy.study.study import Run

STUDY_FILE = "study.yaml"
_FLUSH_S = 1.0
_PART = "?" * 6 + ".parquet"
"""Finished parts; one that a kill interrupted has a longer name."""


class StudyFolder:
    """The files of a study; the table of its rows.

    Args:
        path: an existing folder.
        kind: ``sweep`` or ``margin``.
        columns: names and Parquet types of what the study varies.
        seed: of the scenarios that it keeps.
    """

    def __init__(self, path: Path, kind: str, columns: dict[str, str], seed: int) -> None:
        self.path = path
        self.rows_file = path / f"{kind}.parquet"
        self.summary = path / "summary.json"
        self.report = path / "report.html"
        self.scenarios = path / "scenarios"
        self._seed = seed
        self._parts = path / "rows"
        self._columns = {"point": "string", **columns}
        self._rows = {(row["point"], row["seed"]): row for row in self._kept()}
        self._unwritten: list[Row] = []
        self._flushed_s = time.monotonic()
        self._lock: IO[str] | None = None

    @property
    def rows(self) -> list[Row]:
        """All rows so far, in the order of points, then seeds."""
        return [self._rows[key] for key in sorted(self._rows)]

    def lock(self) -> None:
        """Keep other commands from writing here until this process ends.

        Raises:
            ScenarioError: another one is at it.
        """
        self._lock = (self.path / ".lock").open("w")
        try:
            fcntl.flock(self._lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as error:
            raise ScenarioError(f"--out {self.path}: another command is writing there") from error

    def find(self, run: Run) -> Row | None:
        """The row of a run, if it was done before."""
        return self._rows.get(run.key)

    def add(self, run: Run, values: Row) -> None:
        """Keep the row of a run, and the scenario of its point."""
        self._write_scenario(run)
        self._rows[run.key] = values
        self._unwritten.append(values)
        if time.monotonic() - self._flushed_s >= _FLUSH_S:
            self.flush()

    def flush(self) -> None:
        """Write the rows that are in memory only to a part of their own."""
        if self._unwritten:
            self._parts.mkdir(exist_ok=True)
            taken = (int(part.stem) for part in self._parts.glob(_PART))
            part = self._parts / f"{max(taken, default=0) + 1:06d}.parquet"
            write_rows(self._unwritten, part, self._columns)
            self._unwritten = []
        self._flushed_s = time.monotonic()

    def put_together(self) -> None:
        """Make one table of all rows, in order, of the parts."""
        self.flush()
        write_rows(self.rows, self.rows_file, self._columns)
        for part in self._parts.glob("*"):
            part.unlink()
        if self._parts.is_dir():
            self._parts.rmdir()

    def write_summary(self, summary: dict[str, Any]) -> None:
        """Write ``summary.json``."""
        write_whole(self.summary, json.dumps(summary, indent=2) + "\n")

    def rerun_command(self, point: str) -> str:
        """The command that runs a point again."""
        return f"funnel-hil simulate {self.scenarios / point}.yaml"

    def _write_scenario(self, run: Run) -> None:
        file = self.scenarios / f"{run.point}.yaml"
        if file.exists():
            return
        self.scenarios.mkdir(exist_ok=True)
        setup = load_setup(run.scenario, [*run.overrides, f"seed={self._seed}"])
        write_whole(file, effective_scenario(setup))

    def _kept(self) -> list[Row]:
        files = [self.rows_file, *sorted(self._parts.glob(_PART))]
        return [row for file in files if file.exists() for row in read_rows(file)]


def study_text(kind: str, definition: dict[str, Any], bases: Sequence[Setup]) -> str:
    """What a study is, for ``study.yaml``: equal texts ask for equal rows.

    Args:
        kind: ``sweep`` or ``margin``.
        definition: its definition.
        bases: the scenarios that it varies.
    """
    digests = {base.scenario.name: _digest(base) for base in bases}
    values = {"kind": kind, "definition": definition, "scenario_digests": digests}
    return yaml.safe_dump(values, sort_keys=False, allow_unicode=True)


def find_folder(kind: str, name: str, out: Path | None, text: str) -> Path | None:
    """The folder in which a study is to go on; None if it has to begin.

    Args:
        kind: ``sweep`` or ``margin``.
        name: of the study.
        out: the folder asked for; by default the newest in ``runs`` in which this study came to no
            end.
        text: see `study_text`.

    Raises:
        ScenarioError: the folder asked for holds another study.
    """
    if out is None:
        return _interrupted(f"{kind}-{name}", text)
    path = out.resolve()
    if not (path / STUDY_FILE).exists():
        return None
    if (path / STUDY_FILE).read_text() != text:
        raise ScenarioError(
            f"--out {path}: must be without a study, or hold this one with the same scenario; see"
            f" {path / STUDY_FILE}"
        )
    return path


def create_folder(kind: str, name: str, out: Path | None, text: str) -> Path:
    """A folder for a new study, by default ``runs/<kind>-<name>-<time>``.

    Raises:
        ScenarioError: it cannot be created or written to.
    """
    path = RunFolder.create(f"{kind}-{name}", out).path
    manifest = {**provenance(), "study": yaml.safe_load(text)}
    write_whole(path / "manifest.json", json.dumps(manifest, indent=2) + "\n")
    write_whole(path / STUDY_FILE, text)
    return path


def read_study(path: Path) -> dict[str, Any]:
    """What ``study.yaml`` says.

    Raises:
        RunFolderError: it is not one of ours.
    """
    try:
        values = yaml.safe_load((path / STUDY_FILE).read_text())
    except (OSError, yaml.YAMLError) as error:
        raise RunFolderError(f"{path / STUDY_FILE}: cannot be read: {error}") from error
    known = isinstance(values, dict) and values.get("kind") in ("sweep", "margin")
    if not known or not isinstance(values.get("definition"), dict):
        raise RunFolderError(f"{path / STUDY_FILE}: must have kind sweep or margin, and definition")
    study: dict[str, Any] = values
    return study


def _interrupted(prefix: str, text: str) -> Path | None:
    for path in sorted(Path("runs").glob(f"{prefix}-*"), reverse=True):
        study = path / STUDY_FILE
        if study.is_file() and study.read_text() == text and not _is_complete(path):
            return path.resolve()
    return None


def _is_complete(path: Path) -> bool:
    try:
        return bool(json.loads((path / "summary.json").read_text())["completed"])
    except (OSError, ValueError, KeyError):
        return False


def _digest(setup: Setup) -> str:
    contents = effective_scenario(setup).encode() + setup.robot.path.read_bytes()
    return hashlib.sha256(contents).hexdigest()[:16]
