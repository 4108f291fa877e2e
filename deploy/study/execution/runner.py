"""Execution of a study by workers, also one that was interrupted.

A study requests runs, the workers execute them in any order, and the folder keeps their rows. The
folder is checked before a run is submitted, so nothing is done twice.
"""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace
from itertools import islice
from typing import Protocol

from deploy.judge.run_rows import Row
from deploy.scenario.yaml_files import override
from deploy.study.execution.folder import StudyFolder
from deploy.study.execution.provenance import Provenance
from deploy.study.planned_run import PlannedRun
from deploy.study.study import StudyOfRuns
from plant_emulator.physics.engines import engine_name

_POLL_S = 0.2
_LEAST_IN_FLIGHT = 64
_IN_FLIGHT_PER_WORKER = 4


class WorkersLostError(Exception):
    """The workers are gone; the message says why."""


class Workers(Protocol):
    """Interface of the workers."""

    @property
    def count(self) -> int:
        """Number of runs that they execute at a time."""

    def current(self, parts: Iterable[str]) -> list[Provenance]:
        """Return the present values of parts of a provenance, of each host that may do a run."""

    def submit(self, run: PlannedRun) -> None:
        """Submit a run."""

    def finished(self, timeout_s: float) -> tuple[PlannedRun, Row] | None:
        """Return a finished run, in any order; None if none was finished in time."""


Progress = Callable[[Row, int, bool], None]
"""Called with each row, the largest number of runs, and whether the row existed before."""


def carry_out(
    study: StudyOfRuns,
    workers: Workers,
    folder: StudyFolder,
    stop: threading.Event,
    progress: Progress = lambda _row, _at_most, _before: None,
) -> bool:
    """Execute all runs of a study that its folder lacks; return whether all were done.

    Runs that failed before they could be judged are tried again.

    Args:
        study: the study, which requests runs.
        workers: the workers.
        folder: the folder of existing and new rows.
        stop: set to end early, with all finished rows kept.
        progress: called with every row.
    """
    wanted, crew = deque(study.first()), _Crew(workers, study, folder)

    def take(run: PlannedRun, values: Row, *, was_known: bool) -> None:
        wanted.extend(study.follow(run, values))
        progress(values, study.at_most, was_known)

    try:
        while (wanted or crew.needed) and not stop.is_set():
            while wanted and len(crew.needed) < crew.most_in_flight:
                run = wanted.popleft()
                if (known := folder.find_done(run)) is not None:
                    folder.keep_scenario(run)
                    take(run, known, was_known=True)
                else:
                    crew.request(run)
            if crew.needed:
                crew.work_ahead()
                for run, values in crew.finished():
                    folder.add(run, values)
                    take(run, values, was_known=False)
    finally:
        folder.write()
    if stop.is_set():
        retrace(study, folder, wanted)
    return not stop.is_set()


class _Crew:
    """The workers, with the runs that a study has requested, and with others ahead of that.

    Attributes:
        needed: the requested runs that are not finished.
        most_in_flight: number of runs to request at a time.
    """

    def __init__(self, workers: Workers, study: StudyOfRuns, folder: StudyFolder) -> None:
        self._workers, self._study, self._folder = workers, study, folder
        self._count = workers.count
        self.most_in_flight = max(_LEAST_IN_FLIGHT, _IN_FLIGHT_PER_WORKER * self._count)
        self.needed: set[tuple[str, int]] = set()
        self._at_work: set[tuple[str, int]] = set()
        self._done: dict[tuple[str, int], tuple[PlannedRun, Row]] = {}

    def request(self, run: PlannedRun) -> None:
        """Have a run executed, unless that was done ahead of its request."""
        self.needed.add(run.key)
        if run.key not in self._at_work and run.key not in self._done:
            self._submit(run)

    def work_ahead(self) -> None:
        """Give idle workers runs that may be requested later; of others the rows are dropped."""
        busy = self._at_work | self._done.keys()
        idle = max(0, self._count - len(self._at_work))
        new = (r for r in self._study.ahead() if r.key not in busy and not self._folder.has(r))
        for run in islice(new, idle):
            self._submit(run)

    def finished(self) -> Iterator[tuple[PlannedRun, Row]]:
        """Yield requested runs that are finished, after one has been, or for some time none."""
        if not (self.needed & self._done.keys()):
            if (one := self._workers.finished(_POLL_S)) is None:
                return
            self._at_work.discard(one[0].key)
            self._done[one[0].key] = one
        for key in sorted(self.needed & self._done.keys()):
            self.needed.remove(key)
            yield self._done.pop(key)

    def _submit(self, run: PlannedRun) -> None:
        self._at_work.add(run.key)
        self._workers.submit(self._folder.placed(_on_our_engine(run, self._study)))


def _on_our_engine(run: PlannedRun, study: StudyOfRuns) -> PlannedRun:
    """Return the run with this machine's default engine, so that no worker uses another one."""
    key = "plant.physics.engine"
    plants = [base.scenario.plant for base in study.bases]
    is_chosen = any(plant.physics.engine for plant in plants)
    if is_chosen or any(text.startswith(key) for text in run.overrides):
        return run
    return replace(run, overrides=(override(key, engine_name(plants[0])), *run.overrides))


def retrace(
    study: StudyOfRuns, folder: StudyFolder, wanted: Iterable[PlannedRun] | None = None
) -> None:
    """Pass the existing rows of a study's runs to it, for `wanted` or all."""
    left = deque(study.first() if wanted is None else wanted)
    while left:
        run = left.popleft()
        known = folder.find(run)
        if known is not None:
            left.extend(study.follow(run, known))
