"""What a study leaves, goes on from and grows from: definition, rows, the scenario of every point.

The table of rows is written again soon after runs are done, the more seldom the longer that takes.
It appears as a whole or not at all, so whenever a study is killed, what lies there can be used.

Rows are known by what was varied and the seed: points are named by their place in a study,
and so take other names once it has grown.
"""

from __future__ import annotations

import shutil
import time
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
    """The files of a study; the table of its rows.

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
        """Have the folder hold this study, where it held one that this one has grown from.

        The lock has to be held. Scenarios go, as their names have changed; rows can be found.
        """
        wanted, file = _identity(self._study), self.path / STUDY_FILE
        if read_yaml(file) == wanted:
            return
        shutil.rmtree(self.scenarios, ignore_errors=True)
        before = run_folder.read_manifest(self.path)
        write_json(self.manifest, run_folder.grown_from(before, _manifest(self._study)))
        write_whole(file, to_yaml(wanted))

    def find(self, run: PlannedRun) -> Row | None:
        """The row of a run, if it was done before."""
        if run.key not in self._rows:
            known = self._earlier.get(self._identity({**run.columns, "seed": run.seed}), [])
            if not known:
                return None
            row = min(known, key=lambda row: (left_nothing(row), row["point"] != run.point))
            known.remove(row)
            self._rows[run.key] = {**row, "point": run.point}
        return self._rows[run.key]

    def find_done(self, run: PlannedRun) -> Row | None:
        """The row of a run that need not be done again.

        A recording is of use if it is whole, and of a shipped law: others may have changed since.
        """
        row = self.find(run)
        if row is None or left_nothing(row):
            return None
        if run.recording is None:
            return row
        log = run_folder.RunFolder(self.path / run.recording).log
        return row if row["completed"] and row["law"] in LAWS and log.exists() else None

    def placed(self, run: PlannedRun) -> PlannedRun:
        """The run with the whole path of its recording."""
        recording = None if run.recording is None else self.path / run.recording
        return replace(run, recording=recording)

    def _identity(self, values: Row) -> tuple[Any, ...]:
        """What tells a run or its row from all others of the study."""
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
            conditions: what the rows are to be quoted with.
            completed: whether rows that were not asked for so far will never be: those of a search
                that has grown and took another way.
        """
        began_s = time.monotonic()
        left = [] if completed else [row for rows in self._earlier.values() for row in rows]
        write_rows([*self.rows, *left], self.rows_file, self._columns, conditions)
        took_s = time.monotonic() - began_s
        self._due_s = began_s + max(_WRITE_EVERY_S, took_s / _SHARE_OF_WRITING)

    def rerun_command(self, point: str) -> str:
        """The command that runs a point again."""
        return f"funnel-hil simulate {self.scenarios / point}.yaml"

    def keep_scenario(self, run: PlannedRun) -> None:
        """Write the scenario of a run's point, unless it is there."""
        file = self.scenarios / f"{run.point}.yaml"
        if run.recording is not None or file.exists():
            return
        self.scenarios.mkdir(exist_ok=True)
        setup = load_setup(run.scenario, [*run.overrides, f"seed={self._seed}"])
        write_scenario(setup, file)


def find_folder(study: StudyOfRuns, out: Path | None) -> Path | None:
    """The folder in which a study is to go on, or to grow; None if it has to begin.

    Args:
        study: the study.
        out: the folder asked for; by default the newest in ``runs`` in which this study came to no
            end.

    Raises:
        ScenarioError: the folder asked for holds another study, and not one that this adds to.
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
            f"--out {path}: must be without a study, or hold this one, or one that this one adds"
            f" to; see {file}: {'; '.join(why[:_SHOWN_HINDRANCES])}"
        )
    return path


def create_folder(study: StudyOfRuns, out: Path | None, *, overwrite: bool = False) -> Path:
    """A folder for a new study, by default ``runs/<kind>-<name>-<time>``.

    Raises:
        ScenarioError: as `new_folder`.
    """
    path, identity = new_folder(_folder_name(study), out, overwrite=overwrite), _identity(study)
    write_json(path / "manifest.json", _manifest(study))
    write_whole(path / STUDY_FILE, to_yaml(identity))
    return path


def changes_since(study: StudyOfRuns, path: Path) -> list[str]:
    """Which scenarios and files of a folder's study have changed, a sentence each."""
    return changes(read_yaml(path / STUDY_FILE), _identity(study), _digests(study))


def read_study(path: Path) -> StudyOfRuns:
    """The study that a folder holds.

    Raises:
        RunFolderError: it holds none of ours.
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
    """What a study is, as ``study.yaml`` gives it back: equal ones ask for equal rows."""
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
    """Whether a folder holds a study that came to no end."""
    try:
        found = read_yaml(path / STUDY_FILE)
    except ScenarioError:
        return False
    return found == wanted and not run_folder.read_summary(path).get("completed", False)


def _digests(study: StudyOfRuns) -> set[tuple[str, str]]:
    """Names and digests of the scenarios in every setting that is tried."""
    return {(setup.scenario.name, _digest(setup)) for setup in study.variants}


def _digest(setup: Setup) -> str:
    files = [file.read_bytes() for file in data_files(setup.scenario).values()]
    return digest_of(effective_scenario(setup).encode(), setup.robot.text.encode(), *files)
