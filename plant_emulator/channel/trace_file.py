"""Traces of measured networks: delay or loss of each message over time."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from bus_schema.arrays import Vector
from bus_schema.tables import read_columns
from plant_emulator.channel.round_trips import LONGEST_MS, measured_round_trips

LOST_NS = -1
"""Stands for a delay where a message was lost."""
ONE_WAY, ROUND_TRIP = DELAYS = ("delay_ms", "round_trip_ms")
"""Columns of delays, of which a trace has one."""
_SPARSE_NS = 100_000_000
"""Bursts of some ms pass unseen between messages that are further apart."""
_END_SHARE = 20
_WINDOW = 16
_MOST_CANDIDATES = 400


@dataclass(frozen=True, eq=False)
class Trace:
    """A measured network.

    Attributes:
        times_ns: when each message was sent, from 0 on, not decreasing; shape (messages,).
        delays_ns: how long it took, or `LOST_NS`; shape (messages,).
        is_round_trip: the delays are halves of round trips, and each direction has one half.
        read_as: how another program's file is read; empty for a trace.
    """

    times_ns: NDArray[np.int64]
    delays_ns: NDArray[np.int64]
    is_round_trip: bool = False
    read_as: str = ""

    @property
    def assumed(self) -> str:
        """Sentence on how the file is read, and what it cannot show; empty for nothing to say."""
        return "; ".join(filter(None, [self.read_as, self.sparse_text]))

    @property
    def sparse_text(self) -> str:
        """Say that messages are too rare to show bursts; empty if they are not."""
        if self.gap_ns <= _SPARSE_NS:
            return ""
        return (
            f"a message each {1e-9 * self.gap_ns:.3g} s: bursts between them are not in it;"
            " ping -D -i 0.01 or funnel-hil link sees more"
        )

    @cached_property
    def gap_ns(self) -> int:
        """Median time between messages; also used from the last message to the repeated first."""
        return max(1, int(np.median(np.diff(self.times_ns))))

    @property
    def length_ns(self) -> int:
        """Duration of the trace."""
        return int(self.times_ns[-1]) + self.gap_ns

    @cached_property
    def mean_delay_ns(self) -> int:
        """Mean delay of the messages that were not lost."""
        arrived = self.delays_ns[self.delays_ns >= 0]
        return int(arrived.sum()) // len(arrived)

    @cached_property
    def seam(self) -> tuple[int, int]:
        """Indices of the first and last repeated message, chosen so that delays match there.

        The last messages before the first one and those up to the last one are as alike as any
        two windows near the ends of the trace; messages beyond them play in the first pass alone.
        """
        count = len(self.delays_ns)
        margin = count // _END_SHARE
        window = min(_WINDOW, margin // 2)
        if not window:
            return 0, count - 1
        delays = np.where(self.delays_ns < 0, 2 * self.delays_ns.max(), self.delays_ns)
        windows = np.lib.stride_tricks.sliding_window_view(delays, window)
        step = -(-margin // _MOST_CANDIDATES)
        starts = np.arange(0, margin - window + 1, step)
        ends = np.arange(count - window, count - margin - 1, -step)
        apart = [np.abs(windows[starts] - windows[end]).sum(axis=1) for end in ends]
        end, start = np.unravel_index(int(np.argmin(apart)), (len(ends), len(starts)))
        return int(starts[start]) + window, int(ends[end]) + window - 1


def read_trace(path: Path) -> Trace:
    """Read a trace.

    Args:
        path: CSV or Parquet with columns ``time_s`` and either ``delay_ms`` or ``round_trip_ms``
            (empty: lost), and perhaps ``lost`` (0 or 1) and ``size``, which is ignored. Or what
            `measured_round_trips` reads.

    Raises:
        ValueError: it cannot be read, or holds something else; the message names line and column.
    """
    try:
        status = path.stat()
    except (OSError, ValueError) as error:
        raise ValueError(f"{path} cannot be read: {error}") from error
    return _read(path, status.st_mtime_ns, status.st_size)


@lru_cache(maxsize=4)  # each run of a study needs it, and a large one takes seconds to read
def _read(path: Path, _modified_ns: int, _size: int) -> Trace:
    found = measured_round_trips(path)
    if found is not None:
        is_wrong = found.round_trips_ms < 0.0, found.round_trips_ms > LONGEST_MS
        if np.logical_or(*is_wrong).any():
            raise ValueError(f"{path}: delays must be 0 to {LONGEST_MS:g} ms")
        trace = _trace(path, found.sent_s, found.round_trips_ms, is_round_trip=not found.is_one_way)
        return replace(trace, read_as=found.assumed)
    columns = read_columns(path, ["time_s"], [*DELAYS, "lost", "size"])
    given = [name for name in DELAYS if name in columns.values]
    if len(given) != 1:
        raise ValueError(f"{path}: one of the columns {' and '.join(DELAYS)} must be there")
    times_s, delays_ms = columns.values["time_s"], columns.values[given[0]]
    if columns.rows < 2:
        raise ValueError(f"{path}: a trace needs at least two rows")
    is_lost = np.isnan(delays_ms)
    columns.refuse_where(~np.isfinite(times_s), "time_s", "must be a finite number")
    is_earlier = np.concatenate([[False], np.diff(times_s) < 0.0])
    columns.refuse_where(is_earlier, "time_s", "must not be earlier than in the row before")
    columns.refuse_where(
        ~is_lost & ~((delays_ms >= 0.0) & (delays_ms <= LONGEST_MS)),
        given[0], f"must be 0 to {LONGEST_MS:g} ms, or empty for a lost message",
    )  # fmt: skip
    if "lost" in columns.values:
        allowed = f"must be 1 if {given[0]} is empty, otherwise 0"
        columns.refuse_where(columns.values["lost"] != is_lost, "lost", allowed)
    return _trace(path, times_s, delays_ms, is_round_trip=given[0] == ROUND_TRIP)


def _trace(path: Path, times_s: Vector, delays_ms: Vector, *, is_round_trip: bool) -> Trace:
    """Return a trace of delays, which are NaN where a message was lost."""
    is_lost = np.isnan(delays_ms)
    if is_lost.all() or times_s[-1] == times_s[0]:
        raise ValueError(f"{path}: a trace must have a duration, and some messages must arrive")
    scale = 0.5e6 if is_round_trip else 1e6
    delays_ns = np.rint(np.where(is_lost, 0.0, delays_ms) * scale).astype(np.int64)
    delays_ns[is_lost] = LOST_NS
    times_ns = np.rint((times_s - times_s[0]) * 1e9).astype(np.int64)
    return Trace(times_ns, delays_ns, is_round_trip)
