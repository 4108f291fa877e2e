"""Ticks at which the true motion of a run is known: messages may be missing anywhere."""

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
    """Known part of a run.

    Attributes:
        known: ticks at which the true motion was recorded.
        ticks: number of the run's ticks, as far as known.
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
        """Describe the gaps, such as "2.443 to 2.649 s"; only the first few of many."""
        shown = [
            f"{first:.3f} s" if first == last else f"{first:.3f} to {last:.3f} s"
            for first, last in self.gaps_s[:_SHOWN_GAPS]
        ]
        more = len(self.gaps_s) - len(shown)
        return ", ".join(shown) + (f" and in {more:,} more places" if more else "")


def tick_numbers(run: RunData) -> NDArray[np.int64]:
    """Return the tick of each message of the true motion, by its stamp; 0 is before the first tick.

    Shape (messages,).
    """
    times_s = stamps_s(run.tables[topics.PLANT_TRUTH.name])
    return np.rint(times_s * 1e9 / run.setup.grid.period_ns).astype(np.int64)


def known_ticks(run: RunData) -> KnownTicks:
    """Return the known ticks up to the end that the plant reported, else to the last known one."""
    numbers = tick_numbers(run)
    if (np.diff(numbers) <= 0).any():  # checking costs a tenth of sorting
        numbers = np.unique(numbers)
    values = run.last_values(Role.PLANT, EventKind.ENDED)
    ticks = int(values.get("ticks", numbers.max(initial=0)))
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
    """Return the rows that follow a gap, as ticks before them are missing.

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
    # Topics other than the truth may lack more or fewer messages at the ends of a gap.
    within = np.searchsorted(gaps[:, 0], pairs[1]) - np.searchsorted(gaps[:, 1], pairs[0], "right")
    return np.flatnonzero((within > 0) & (pairs[1] - pairs[0] > 1.0))


def longest_run(flags: NDArray[np.bool_], after_gaps: Rows = NO_ROWS) -> int:
    """Return the largest number of consecutive flags that are set.

    Args:
        flags: one per tick.
        after_gaps: flags that follow a gap, in which the flags are unknown.
    """
    flags = np.insert(flags, after_gaps, False)
    edges = np.flatnonzero(np.diff(np.concatenate(([0], flags.astype(np.int8), [0]))))
    return int((edges[1::2] - edges[::2]).max()) if edges.size else 0
