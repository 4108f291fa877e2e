"""Studies: many runs of scenarios, carried out by workers, each of them a row of a table.

A plan says which runs are wanted, the workers do them in any order, and a table keeps what came of
them. A plan may ask for more once it has seen a row, which is how a search works; and as the table
is asked before the workers, a study that was interrupted goes on where it stopped.
"""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any, Protocol

from deploy.runs.metrics import summarise
from deploy.runs.run_rows import Row, failed_row, row
from deploy.runs.simulate import attempt
from deploy.scenario.scenario import load_setup

_POLL_S = 0.2
_LEAST_IN_FLIGHT = 64
_IN_FLIGHT_PER_WORKER = 4


@dataclass(frozen=True)
class Run:
    """One run of a study.

    Attributes:
        point: name of what was chosen for it, all but the seed; names sort in the order of a study.
        scenario: a scenario file, or the name of a shipped one.
        overrides: what is set in it, as ``dotted.key=value``, but for the seed.
        seed: the scenario's seed.
        columns: what the study varies, by column of its table.
    """

    point: str
    scenario: str
    overrides: tuple[str, ...]
    seed: int
    columns: dict[str, Any]

    @property
    def key(self) -> tuple[str, int]:
        """What tells it from all other runs of its study."""
        return self.point, self.seed


def execute(run: Run) -> Row:
    """Simulate and judge; whatever goes wrong is the row's `error`."""
    try:
        setup = load_setup(run.scenario, [*run.overrides, f"seed={run.seed}"])
        values = row(summarise(attempt(setup).data()), setup.scenario.seed)
    except Exception as error:  # noqa: BLE001 - one bad run must not end a study
        values = failed_row(run.seed, f"{type(error).__name__}: {error}")
    return labelled(run, values)


def labelled(run: Run, values: Row) -> Row:
    """A row with what the study varies in front."""
    return {"point": run.point, **run.columns, **values}


class Plan(Protocol):
    """Which runs a study wants."""

    def first(self) -> Iterable[Run]:
        """Runs that are wanted from the beginning."""

    def follow(self, run: Run, values: Row) -> Iterable[Run]:
        """Runs that are wanted now that a run's row is known."""

    @property
    def expected(self) -> int:
        """How many runs there will be, as far as can be told now."""


class Workers(Protocol):
    """Who does the runs."""

    @property
    def count(self) -> int:
        """How many runs they do at a time."""

    def submit(self, run: Run) -> None:
        """Have a run done."""

    def finished(self, timeout_s: float) -> tuple[Run, Row] | None:
        """A run that is done, in any order; None if none was done in time."""


class Table(Protocol):
    """Where rows are kept."""

    def find(self, run: Run) -> Row | None:
        """The row of a run, if it was done before."""

    def add(self, run: Run, values: Row) -> None:
        """Keep the row of a run."""


class Progress(Protocol):
    """Who is told how far a study is."""

    def done(self, values: Row, expected: int, *, before: bool) -> None:
        """A run is done, now or by an earlier command; `expected` runs there will be in all."""


def carry_out(
    plan: Plan, workers: Workers, table: Table, progress: Progress, stop: threading.Event
) -> bool:
    """Do all runs that a plan wants and that the table lacks; whether all were done.

    Args:
        plan: which runs are wanted.
        workers: who does them.
        table: what was done before, and where the rows go.
        progress: told of every row.
        stop: set to end early, with all finished rows kept.
    """
    wanted, in_flight = deque(plan.first()), 0
    most_in_flight = max(_LEAST_IN_FLIGHT, _IN_FLIGHT_PER_WORKER * workers.count)
    while (wanted or in_flight) and not stop.is_set():
        while wanted and in_flight < most_in_flight:
            run = wanted.popleft()
            known = table.find(run)
            if known is None:
                workers.submit(run)
                in_flight += 1
            else:
                wanted.extend(plan.follow(run, known))
                progress.done(known, plan.expected, before=True)
        finished = workers.finished(_POLL_S) if in_flight else None
        if finished is not None:
            run, values = finished
            in_flight -= 1
            table.add(run, values)
            wanted.extend(plan.follow(run, values))
            progress.done(values, plan.expected, before=False)
    return not stop.is_set()


def retrace(plan: Plan, table: Table) -> None:
    """Take a plan through all of its runs that a table has."""
    wanted = deque(plan.first())
    while wanted:
        run = wanted.popleft()
        known = table.find(run)
        if known is not None:
            wanted.extend(plan.follow(run, known))
