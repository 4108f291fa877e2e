"""Folder of a study, from which it can continue or grow: definition, rows, scenarios of points.

The table of rows is rewritten soon after runs are done, less often if that takes long. It is
written whole or not at all, so the folder of a killed study can always be used.

Rows are identified by the varied values and the seed: points are named by their position in a
study, and so are renamed when it grows. Each row names its provenance, of which
``provenance.json`` has all; a folder with rows of another provenance than today's is refused. Rows
of a law that may have read something unseen are not used again: each command makes its own.
"""

from __future__ import annotations

import json
import shutil
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

from bus_schema.recording.atomic_files import write_json, write_whole
from bus_schema.user_files import is_file
from deploy.judge.conditions import Conditions
from deploy.judge.run_rows import PROVENANCE, Row, left_nothing, read_rows, write_rows
from deploy.judge.tested_with import TESTED_WITH
from deploy.run import run_folder
from deploy.run.confirmation import CONFIRMATION_COLUMNS
from deploy.run.new_folder import new_folder, resolved_out
from deploy.scenario.effective import write_scenario
from deploy.scenario.scenario import load_setup
from deploy.scenario.yaml_files import ScenarioError, read_yaml, to_yaml
from deploy.study.execution.growth import hindrances
from deploy.study.execution.identity import STUDY_FILE, digests_of, has_definition, identity_of
from deploy.study.execution.provenance import (
    UNSEEN,
    Provenance,
    current,
    differences,
    law_files,
    provenance_of_law,
)
from deploy.study.planned_run import PlannedRun
from deploy.study.study import StudyOfRuns, digest_of

_PROVENANCES_FILE = "provenance.json"
_WRITE_EVERY_S, _SHARE_OF_WRITING = 1.0, 0.05
_SHOWN_HINDRANCES = 3
_NO_PROVENANCE = "an older version of funnel-hil made them and recorded neither"

Current = Callable[[Iterable[str]], list[Provenance]]
"""Returns the present values of parts of a provenance, of each host that may do a run."""


def here(parts: Iterable[str]) -> list[Provenance]:
    """Return the present values of parts of a provenance in this process."""
    return [current(parts)]


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
        known = run_folder.read_json(path / _PROVENANCES_FILE).items()
        self._provenances = {key: parts for key, parts in known if isinstance(parts, dict)}
        self._of_law = cache(provenance_of_law)
        self.reused = self.made_again = 0
        self._due_s = time.monotonic() + _WRITE_EVERY_S

    @property
    def rows(self) -> list[Row]:
        """All rows so far, in the order of points, then seeds."""
        return [self._rows[key] for key in sorted(self._rows)]

    @property
    def note(self) -> str:
        """Sentence on rows of earlier commands, and on inputs that changed while rows were made.

        Empty if neither.
        """
        values: dict[str, set[str]] = {}
        for row in self.rows:
            for part, value in self._made_by(row).items():
                values.setdefault(part, set()).add(value)
        values.pop(UNSEEN, None)
        changed = ", ".join(part for part, found in values.items() if len(found) > 1)
        count = f"{self.reused} of {len(self._rows)} runs are from before, with the same inputs"
        notes = {
            count: self.reused,
            f"{self.made_again} runs were made again": self.made_again,
            f"{changed} changed between its runs": changed,
        }
        return "; ".join(text for text, is_so in notes.items() if is_so)

    @property
    def unseen(self) -> str:
        """A sentence about rows that no later command uses again, with the reason; else empty."""
        reasons = {self._made_by(row).get(UNSEEN): None for row in self.rows}
        texts = [reason for reason in reasons if reason]
        return f"{'; '.join(texts)}: each command makes these runs again" if texts else ""

    def drop_unseen(self) -> None:
        """Drop earlier rows whose law may have read something that is not seen."""
        for identity, rows in self._earlier.items():
            kept = [row for row in rows if UNSEEN not in self._made_by(row)]
            self.made_again += len(rows) - len(kept)
            self._earlier[identity] = kept

    def _made_by(self, row: Row) -> Provenance:
        return self._provenances.get(str(row.get(PROVENANCE)), {})

    def become(self) -> None:
        """Make the folder hold this study, which has grown from the one in it.

        The lock has to be held. Scenarios are removed, as their names have changed; rows are still
        found.
        """
        wanted, file = identity_of(self._study), self.path / STUDY_FILE
        if read_yaml(file) == wanted:
            return
        shutil.rmtree(self.scenarios, ignore_errors=True)
        before = run_folder.read_manifest(self.path)
        write_json(self.manifest, run_folder.grown_from(before, _manifest(self._study)))
        write_whole(file, to_yaml(wanted))

    def has(self, run: PlannedRun) -> bool:
        """Whether there is a row of a run, also of one that is not requested."""
        identity = self._identity({**run.columns, "seed": run.seed})
        return run.key in self._rows or bool(self._earlier.get(identity))

    def find(self, run: PlannedRun) -> Row | None:
        """Return the row of a run that was done before; None without one."""
        if run.key not in self._rows:
            known = self._earlier.get(self._identity({**run.columns, "seed": run.seed}), [])
            if not known:
                return None
            row = min(known, key=lambda row: (left_nothing(row), row["point"] != run.point))
            known.remove(row)
            self._rows[run.key] = {**row, **run.columns, "point": run.point}  # some may be new
        return self._rows[run.key]

    def find_done(self, run: PlannedRun) -> Row | None:
        """Return the row of a run that need not be repeated; None without one.

        A recording is reused if it is whole.
        """
        row = self.find(run)
        if row is None or left_nothing(row):
            return None
        if run.recording is not None:
            log = run_folder.RunFolder(self.path / run.recording).log
            if not (row["completed"] and log.exists()):
                return None
        self.reused += 1
        return row

    def changes(self, now: Current) -> list[str]:
        """Return what has changed since the existing rows were made, a sentence for each part.

        Args:
            now: returns the present values; any host may have those of the rows.
        """
        made_by = self._earlier_made_by
        if {} in made_by:
            return [_NO_PROVENANCE]
        made_by = [each for each in made_by if UNSEEN not in each]
        laws = {k: v for law in self._study.laws for k, v in self._of_law(law).items()}
        hosts = now({part for each in made_by for part in each})
        found = [
            [change for each in made_by for change in differences(each, {**host, **laws})]
            for host in hosts
        ]
        found.sort(key=len)
        return list(dict.fromkeys(found[0])) if found else []

    @property
    def law_changes(self) -> list[str]:
        """Source files of custom laws that have changed since the existing rows were made.

        A sentence each; no law is imported.
        """
        files = map(law_files, self._earlier_made_by)
        found = (change for each in files for change in differences(each, current(each)))
        return list(dict.fromkeys(found))

    @property
    def _earlier_made_by(self) -> list[Provenance]:
        """Each provenance of existing rows; empty for an unknown one."""
        rows = [row for rows in self._earlier.values() for row in rows if not left_nothing(row)]
        keys = {str(row.get(PROVENANCE)) for row in rows}
        return [self._provenances.get(key, {}) for key in sorted(keys)]

    def placed(self, run: PlannedRun) -> PlannedRun:
        """Return the run with the full path of its recording."""
        recording = None if run.recording is None else self.path / run.recording
        return replace(run, recording=recording)

    def _identity(self, values: Row) -> tuple[Any, ...]:
        """Return the values that identify a run or its row within the study."""
        identity = (values.get(name) for name in (*self._study.columns, "seed"))
        return tuple(tuple(each) if isinstance(each, list) else each for each in identity)

    def add(self, run: PlannedRun, values: Row) -> None:
        """Keep the row of a run, its provenance with the code of its law, and its scenario."""
        self.keep_scenario(run)
        made_by = {**self._of_law(values["law"] or ""), **(values.get(PROVENANCE) or {})}
        made_by = {part: value for part, value in made_by.items() if value}  # others it has written
        key = digest_of(json.dumps(made_by, sort_keys=True).encode())
        self._provenances[key] = made_by
        self._rows[run.key] = {**values, PROVENANCE: key}
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
        write_json(self.path / _PROVENANCES_FILE, self._provenances)
        left = [row for rows in self._earlier.values() for row in rows]
        left = [row for row in left if not completed or self._study.keeps(row)]
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
        overrides = [*run.overrides, f"seed={self._seed}"]
        setup = load_setup(run.scenario, overrides, creates_sides=False)  # its worker has done that
        write_scenario(setup, file)


def find_folder(study: StudyOfRuns, out: Path | None) -> Path | None:
    """Return the folder in which a study continues or grows; None if it has to begin.

    Args:
        study: the study.
        out: the requested folder; by default the newest one in ``runs`` with this study, if it is
            unfinished.

    Raises:
        ScenarioError: that folder holds another study, which this one does not extend.
    """
    wanted = identity_of(study)
    if out is None:
        begun = sorted(Path("runs").glob(f"{_folder_name(study)}-*"), reverse=True)
        newest = next((path for path in begun if has_definition(path, wanted)), None)
        if newest is None or run_folder.read_summary(newest).get("completed", False):
            return None
        out = newest
    path = resolved_out(out)
    file = path / STUDY_FILE
    if not is_file(file):
        return None
    why = hindrances(read_yaml(file), wanted, digests_of(study), study.growth)
    if why:
        raise ScenarioError(
            f"--out {path}: has another study, which this one does not extend; see {file}:"
            f" {'; '.join(why[:_SHOWN_HINDRANCES])}"
        )
    return path


def require_same_provenance(study: StudyOfRuns, path: Path | None, now: Current = here) -> None:
    """Check that nothing has changed that made the rows in a study's folder.

    Args:
        study: the study.
        path: its folder by `find_folder`.
        now: as for `StudyFolder.changes`.

    Raises:
        ScenarioError: something has changed; the message names it, with the values of both times.
    """
    why = [] if path is None else StudyFolder(path, study).changes(now)
    if why:
        raise ScenarioError(
            f"{path}: its rows were made with other code, files or versions:"
            f" {'; '.join(why[:_SHOWN_HINDRANCES])}:"
            f" --out {path} --overwrite makes them again, and a new --out keeps them"
        )


def create_folder(study: StudyOfRuns, out: Path | None, *, overwrite: bool = False) -> Path:
    """Create a folder for a new study, by default ``runs/<kind>-<name>-<time>``.

    Raises:
        ScenarioError: as for `new_folder`.
    """
    path, identity = new_folder(_folder_name(study), out, overwrite=overwrite), identity_of(study)
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
        folder.drop_unseen()
        yield folder


def _folder_name(study: StudyOfRuns) -> str:
    return f"{study.kind}-{study.definition.name}"


def _manifest(study: StudyOfRuns) -> dict[str, Any]:
    tested = {TESTED_WITH: study.tested_with}
    return {**study.provenance(), **tested, "study": identity_of(study)}
