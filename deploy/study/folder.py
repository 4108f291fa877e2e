"""Folder of a study, from which it can continue or grow: definition, rows, scenarios of points.

The table of rows is rewritten soon after runs are done, less often if that takes long. It is
written whole or not at all, so the folder of a killed study can always be used.

Rows are identified by the varied values and the seed: points are named by their position in a
study, and so are renamed when it grows.
"""

from __future__ import annotations

import shutil
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

from bus_schema.recording.atomic_files import write_json, write_whole
from bus_schema.user_files import is_file
from controller.laws import LAWS
from deploy.judge.conditions import Conditions
from deploy.judge.run_rows import Row, left_nothing, read_rows, write_rows
from deploy.run import run_folder
from deploy.run.confirmation import CONFIRMATION_COLUMNS
from deploy.run.new_folder import new_folder, resolved_out
from deploy.scenario.effective import effective_scenario, write_scenario
from deploy.scenario.referenced_files import data_files
from deploy.scenario.scenario import load_setup
from deploy.scenario.setup import Setup
from deploy.scenario.yaml_files import ScenarioError, read_yaml, to_yaml
from deploy.scenario.yaml_text import values_of
from deploy.study.comparison.comparison import Comparison
from deploy.study.growth import changes, hindrances
from deploy.study.margin import Margin
from deploy.study.robustness import Robustness
from deploy.study.study import PlannedRun, StudyOfRuns, digest_of
from deploy.study.sweep import Sweep

STUDY_FILE = "study.yaml"
KINDS: dict[str, type[StudyOfRuns]] = {
    kind.kind: kind for kind in (Sweep, Margin, Robustness, Comparison)
}
_WRITE_EVERY_S, _SHARE_OF_WRITING = 1.0, 0.05
_SHOWN_HINDRANCES = 3


class StudyFolder(run_folder.ResultFolder):
    """The files of a study, and the table of its rows.

    Args:
        path: an existing folder.
        study: the study.
    """

    def __init__(self, path: Path, study: StudyOfRuns) -> None:
        super().__init__(path)
        self.rows_file = path / f"{study.kind}.parquet"
        self.scenarios = path / "scenarios"
        self._study, self._seed = study, study.definition.seeds[0]
        confirmed = CONFIRMATION_COLUMNS if study.definition.confirm else {}
        self._columns = {"point": "string", **study.columns, **confirmed}
        self._earlier: dict[tuple[Any, ...], list[Row]] = {}
        for row in read_rows(self.rows_file) if self.rows_file.exists() else ():
            self._earlier.setdefault(self._identity(row), []).append(row)
        self._rows: dict[tuple[str, int], Row] = {}
        self._due_s = time.monotonic() + _WRITE_EVERY_S

    @property
    def rows(self) -> list[Row]:
        """All rows so far, in the order of points, then seeds."""
        return [self._rows[key] for key in sorted(self._rows)]

    def become(self) -> None:
        """Make the folder hold this study, which has grown from the one in it.

        The lock has to be held. Scenarios are removed, as their names have changed; rows are still
        found.
        """
        wanted, file = _identity(self._study), self.path / STUDY_FILE
        if read_yaml(file) == wanted:
            return
        shutil.rmtree(self.scenarios, ignore_errors=True)
        before = run_folder.read_manifest(self.path)
        write_json(self.manifest, run_folder.grown_from(before, _manifest(self._study)))
        write_whole(file, to_yaml(wanted))

    def find(self, run: PlannedRun) -> Row | None:
        """Return the row of a run that was done before; None without one."""
        if run.key not in self._rows:
            known = self._earlier.get(self._identity({**run.columns, "seed": run.seed}), [])
            if not known:
                return None
            row = min(known, key=lambda row: (left_nothing(row), row["point"] != run.point))
            known.remove(row)
            self._rows[run.key] = {**row, "point": run.point}
        return self._rows[run.key]

    def find_done(self, run: PlannedRun) -> Row | None:
        """Return the row of a run that need not be repeated; None without one.

        A recording is reused if it is whole, and of a shipped law: others may have changed since.
        """
        row = self.find(run)
        if row is None or left_nothing(row):
            return None
        if run.recording is None:
            return row
        log = run_folder.RunFolder(self.path / run.recording).log
        return row if row["completed"] and row["law"] in LAWS and log.exists() else None

    def placed(self, run: PlannedRun) -> PlannedRun:
        """Return the run with the full path of its recording."""
        recording = None if run.recording is None else self.path / run.recording
        return replace(run, recording=recording)

    def _identity(self, values: Row) -> tuple[Any, ...]:
        """Return the values that identify a run or its row within the study."""
        told = (values.get(name) for name in (*self._study.columns, "seed"))
        return tuple(tuple(each) if isinstance(each, list) else each for each in told)

    def add(self, run: PlannedRun, values: Row) -> None:
        """Keep the row of a run, and the scenario of its point."""
        self.keep_scenario(run)
        self._rows[run.key] = values
        if time.monotonic() >= self._due_s:
            self.write()

    def write(self, conditions: Conditions | None = None, *, completed: bool = False) -> None:
        """Write one table of all rows, in order.

        Args:
            conditions: the conditions of the rows.
            completed: whether unrequested rows can be dropped: those of a search that has grown and
                took another path.
        """
        began_s = time.monotonic()
        left = [] if completed else [row for rows in self._earlier.values() for row in rows]
        write_rows([*self.rows, *left], self.rows_file, self._columns, conditions)
        took_s = time.monotonic() - began_s
        self._due_s = began_s + max(_WRITE_EVERY_S, took_s / _SHARE_OF_WRITING)

    def rerun_command(self, point: str) -> str:
        """Return the command that repeats a point."""
        return f"funnel-hil simulate {self.scenarios / point}.yaml"

    def keep_scenario(self, run: PlannedRun) -> None:
        """Write the scenario of a run's point, unless it exists."""
        file = self.scenarios / f"{run.point}.yaml"
        if run.recording is not None or file.exists():
            return
        self.scenarios.mkdir(exist_ok=True)
        setup = load_setup(run.scenario, [*run.overrides, f"seed={self._seed}"])
        write_scenario(setup, file)


def find_folder(study: StudyOfRuns, out: Path | None) -> Path | None:
    """Return the folder in which a study continues or grows; None if it has to begin.

    Args:
        study: the study.
        out: the requested folder; by default the newest one in ``runs`` with this study unfinished.

    Raises:
        ScenarioError: the requested folder holds another study, which this one does not extend.
    """
    wanted = _identity(study)
    if out is None:
        begun = sorted(Path("runs").glob(f"{_folder_name(study)}-*"), reverse=True)
        return next((path.resolve() for path in begun if _can_go_on(path, wanted)), None)
    path = resolved_out(out)
    file = path / STUDY_FILE
    if not is_file(file):
        return None
    why = hindrances(read_yaml(file), wanted, _digests(study))
    if why:
        raise ScenarioError(
            f"--out {path}: has another study, which this one does not extend; see {file}:"
            f" {'; '.join(why[:_SHOWN_HINDRANCES])}"
        )
    return path


def create_folder(study: StudyOfRuns, out: Path | None, *, overwrite: bool = False) -> Path:
    """Create a folder for a new study, by default ``runs/<kind>-<name>-<time>``.

    Raises:
        ScenarioError: as for `new_folder`.
    """
    path, identity = new_folder(_folder_name(study), out, overwrite=overwrite), _identity(study)
    write_json(path / "manifest.json", _manifest(study))
    write_whole(path / STUDY_FILE, to_yaml(identity))
    return path


@contextmanager
def opened(
    study: StudyOfRuns, path: Path | None, out: Path | None, *, overwrite: bool = False
) -> Iterator[StudyFolder]:
    """Lock the folder of a study to carry it out there.

    Args:
        study: the study.
        path: its folder by `find_folder`; None creates one.
        out: as for `create_folder`.
        overwrite: likewise.
    """
    place = path or create_folder(study, out, overwrite=overwrite)
    with StudyFolder(place, study).lock() as folder:
        folder.become()
        yield folder


def changes_since(study: StudyOfRuns, path: Path) -> list[str]:
    """Return which scenarios and files of a folder's study have changed, a sentence each."""
    return changes(read_yaml(path / STUDY_FILE), _identity(study), _digests(study))


def read_study(path: Path) -> StudyOfRuns:
    """Return the study in a folder.

    Raises:
        RunFolderError: it holds no study.
        ScenarioError: the study cannot be used.
    """
    file = path / STUDY_FILE
    values = read_yaml(file)
    kind, definition = KINDS.get(str(values.get("kind"))), values.get("definition")
    if kind is None or not isinstance(definition, dict):
        raise run_folder.RunFolderError(
            f"{file}: must have kind {' or '.join(KINDS)}, and definition"
        )
    return kind(definition, file)


def _folder_name(study: StudyOfRuns) -> str:
    return f"{study.kind}-{study.definition.name}"


def _identity(study: StudyOfRuns) -> dict[str, Any]:
    """Return a study's identity, in the form of ``study.yaml``: equal ones request equal rows."""
    told = {
        "kind": study.kind,
        "definition": study.definition.model_dump(by_alias=True),
        "scenario_digests": {base.scenario.name: _digest(base) for base in study.bases},
        **({"file_digests": dict(study.files)} if study.files else {}),
    }
    given_back: dict[str, Any] = values_of(to_yaml(told))  # a tuple is a list there
    return given_back


def _manifest(study: StudyOfRuns) -> dict[str, Any]:
    return {**study.provenance(), "study": _identity(study)}


def _can_go_on(path: Path, wanted: dict[str, Any]) -> bool:
    """Whether a folder holds an unfinished study."""
    try:
        found = read_yaml(path / STUDY_FILE)
    except ScenarioError:
        return False
    return found == wanted and not run_folder.read_summary(path).get("completed", False)


def _digests(study: StudyOfRuns) -> set[tuple[str, str]]:
    """Return names and digests of the scenarios in every setting."""
    return {(setup.scenario.name, _digest(setup)) for setup in study.variants}


def _digest(setup: Setup) -> str:
    files = [file.read_bytes() for file in data_files(setup.scenario).values()]
    return digest_of(effective_scenario(setup).encode(), setup.robot.text.encode(), *files)
