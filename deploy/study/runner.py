"""How a study is carried out by workers, and goes on where it was interrupted.

A study says which runs are wanted, the workers do them in any order, and the folder keeps what came
of them. As the folder is asked before the workers, nothing is done twice.
"""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable, Iterable
from dataclasses import replace
from typing import Protocol

from deploy.judge.run_rows import Row
from deploy.scenario.yaml_files import override
from deploy.study.folder import StudyFolder
from deploy.study.study import PlannedRun, StudyOfRuns
from plant_emulator.physics.engines import engine_name

_POLL_S = 0.2
_LEAST_IN_FLIGHT = 64
_IN_FLIGHT_PER_WORKER = 4


class Workers(Protocol):
    """Who does the runs."""

    @property
    def count(self) -> int:
        """How many runs they do at a time."""

    def submit(self, run: PlannedRun) -> None:
        """Have a run done."""

    def finished(self, timeout_s: float) -> tuple[PlannedRun, Row] | None:
        """A run that is done, in any order; None if none was done in time."""


Progress = Callable[[Row, int, bool], None]
"""Is called with the row of each run, with how many runs there will be in all, and whether an
earlier command did this one."""


def carry_out(
    study: StudyOfRuns,
    workers: Workers,
    folder: StudyFolder,
    stop: threading.Event,
    progress: Progress = lambda _row, _expected, _before: None,
) -> bool:
    """Do all runs that a study wants and that its folder lacks; whether all were done.

    Runs that failed before they could be judged are tried again.

    Args:
        study: which runs are wanted.
        workers: who does them.
        folder: what was done before, and where the rows go.
        stop: set to end early, with all finished rows kept.
        progress: called with every row.
    """
    wanted, in_flight = deque(study.first()), 0
    most_in_flight = max(_LEAST_IN_FLIGHT, _IN_FLIGHT_PER_WORKER * workers.count)
    try:
        while (wanted or in_flight) and not stop.is_set():
            while wanted and in_flight < most_in_flight:
                run = wanted.popleft()
                known = folder.find_done(run)
                if known is None:
                    workers.submit(folder.placed(_on_our_engine(run, study)))
                    in_flight += 1
                else:
                    folder.keep_scenario(run)
                    wanted.extend(study.follow(run, known))
                    progress(known, study.expected, True)
            finished = workers.finished(_POLL_S) if in_flight else None
            if finished is not None:
                run, values = finished
                in_flight -= 1
                folder.add(run, values)
                wanted.extend(study.follow(run, values))
                progress(values, study.expected, False)
    finally:
        folder.write()
    if stop.is_set():
        retrace(study, folder, wanted)
    return not stop.is_set()


def _on_our_engine(run: PlannedRun, study: StudyOfRuns) -> PlannedRun:
    """The run with the engine that is the default here, so that no worker takes another one."""
    key = "plant.physics.engine"
    plants = [base.scenario.plant for base in study.bases]
    is_chosen = any(plant.physics.engine for plant in plants)
    if is_chosen or any(text.startswith(key) for text in run.overrides):
        return run
    return replace(run, overrides=(override(key, engine_name(plants[0])), *run.overrides))


def retrace(
    study: StudyOfRuns, folder: StudyFolder, wanted: Iterable[PlannedRun] | None = None
) -> None:
    """Take a study through those of its runs that its folder has; through `wanted` or all."""
    left = deque(study.first() if wanted is None else wanted)
    while left:
        run = left.popleft()
        known = folder.find(run)
        if known is not None:
            left.extend(study.follow(run, known))
