"""Execution of a study by workers, also one that was interrupted.

A study requests runs, the workers execute them in any order, and the folder keeps their rows. The
folder is checked before a run is submitted, so nothing is done twice.
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
    """Interface of the workers."""

    @property
    def count(self) -> int:
        """Number of runs that they execute at a time."""

    def submit(self, run: PlannedRun) -> None:
        """Submit a run."""

    def finished(self, timeout_s: float) -> tuple[PlannedRun, Row] | None:
        """Return a finished run, in any order; None if none was finished in time."""


Progress = Callable[[Row, int, bool], None]
"""Called with each run's row, the expected number of runs, and whether the row existed before.
earlier command did this one."""


def carry_out(
    study: StudyOfRuns,
    workers: Workers,
    folder: StudyFolder,
    stop: threading.Event,
    progress: Progress = lambda _row, _expected, _before: None,
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
