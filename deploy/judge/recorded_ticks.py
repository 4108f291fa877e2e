"""At which of its ticks the true motion of a run is known: messages may be missing anywhere."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from bus_schema.arrays import Vector
from bus_schema.messages import topics
from bus_schema.messages.run_event import EventKind
from bus_schema.messages.topics import Role
from deploy.judge.run_data import RunData, stamps_s

Rows = NDArray[np.intp]
NO_ROWS: Rows = np.zeros(0, dtype=np.intp)

_SHOWN_GAPS = 3


class KnownTicks(NamedTuple):
    """How much of a run is known.

    Attributes:
        known: ticks at which the true motion was recorded.
        ticks: of the run, as far as is known.
        gaps_s: first and last tick of each gap between them, on the run's clock.
    """

    known: int
    ticks: int
    gaps_s: list[tuple[float, float]]

    @property
    def missing(self) -> int:
        return self.ticks - self.known

    @property
    def gaps_text(self) -> str:
        """Where the gaps are, such as "2.443 to 2.649 s"; the first few of many."""
        shown = [
            f"{first:.3f} s" if first == last else f"{first:.3f} to {last:.3f} s"
            for first, last in self.gaps_s[:_SHOWN_GAPS]
        ]
        more = len(self.gaps_s) - len(shown)
        return ", ".join(shown) + (f" and in {more:,} more places" if more else "")


def tick_numbers(run: RunData) -> NDArray[np.int64]:
    """The tick of each message of the true motion, by its stamp; 0 is where the arm stood before.

    Shape (messages,).
    """
    times_s = stamps_s(run.tables[topics.PLANT_TRUTH.name])
    return np.rint(times_s * 1e9 / run.setup.grid.period_ns).astype(np.int64)


def known_ticks(run: RunData) -> KnownTicks:
    """What is known of a run, up to the end that the plant told; else to the last tick known."""
    numbers = tick_numbers(run)
    if (np.diff(numbers) <= 0).any():  # to look costs a tenth of what sorting does
        numbers = np.unique(numbers)
    told = run.last_values(Role.PLANT, EventKind.ENDED)
    ticks = int(told.get("ticks", numbers.max(initial=0)))
    numbers = numbers[(numbers >= 1) & (numbers <= ticks)]
    around = np.concatenate(([0], numbers, [ticks + 1]))
    period_s = run.setup.grid.period_ns * 1e-9
    before = np.flatnonzero(np.diff(around) > 1)
    gaps_s = [
        (float((around[each] + 1) * period_s), float((around[each + 1] - 1) * period_s))
        for each in before
    ]
    return KnownTicks(len(numbers), ticks, gaps_s)


def rows_after_gaps(run: RunData, times_s: Vector) -> Rows:
    """The rows that are no neighbours of those before them, as ticks in between are missing.

    Args:
        run: the run.
        times_s: stamps of the rows, shape (rows,).
    """
    period_ns = run.setup.grid.period_ns
    gaps_s = known_ticks(run).gaps_s
    if not gaps_s:
        return NO_ROWS
    gaps = np.rint(np.reshape(gaps_s, (-1, 2)) * 1e9 / period_ns)
    ticks = np.rint(times_s * 1e9 / period_ns)
    pairs = np.sort(np.stack([np.concatenate(([-1.0], ticks))[:-1], ticks]), axis=0)
    # Of other topics than the truth more or less may be missing at the ends of a gap.
    within = np.searchsorted(gaps[:, 0], pairs[1]) - np.searchsorted(gaps[:, 1], pairs[0], "right")
    return np.flatnonzero((within > 0) & (pairs[1] - pairs[0] > 1.0))


def longest_run(flags: NDArray[np.bool_], after_gaps: Rows = NO_ROWS) -> int:
    """The largest number of flags in a row that are set.

    Args:
        flags: one a tick.
        after_gaps: those before which some are missing, of which nobody knows whether they were.
    """
    flags = np.insert(flags, after_gaps, False)
    edges = np.flatnonzero(np.diff(np.concatenate(([0], flags.astype(np.int8), [0]))))
    return int((edges[1::2] - edges[::2]).max()) if edges.size else 0
