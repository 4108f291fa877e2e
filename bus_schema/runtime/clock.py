"""Clocks of a run: time since its start in whole nanoseconds, virtual or monotonic."""

from __future__ import annotations

import contextlib
import ctypes
import datetime as dt
import time
import zlib
from pathlib import Path
from typing import Protocol

_yield_cpu = ctypes.CDLL(None).sched_yield
"""Yields to threads of the same priority; Python's own function keeps the interpreter lock."""


class Clock(Protocol):
    """Interface of the clocks of a run.

    Attributes:
        awake_ns: waits up to this long are spent awake.
    """

    awake_ns: int

    def start(self) -> None:
        """Start the run: time is 0 now."""

    def anchor(self, ago_ns: int) -> None:
        """Note that the run began `ago_ns` ago, by an external sign: `start` sets time 0 there.

        Until `start`, time goes on as before. Virtual time ignores the note and begins with
        `start`.
        """

    def put_forward(self, by_ns: int) -> None:
        """Advance the clock by so much; set it back a little if negative.

        Virtual time is not changed.
        """

    def now_ns(self) -> int:
        """Return the time since the start of the run."""

    def wait_until(self, instant_ns: int) -> int:
        """Wait until `instant_ns`; return the lateness in ns."""


class VirtualClock:
    """Time that passes only while its owner waits: never late, however slow the machine is."""

    awake_ns = 0

    def __init__(self) -> None:
        self._now_ns = 0

    def start(self) -> None:
        self._now_ns = 0

    def anchor(self, ago_ns: int) -> None:
        """Do nothing: virtual time begins when its owner starts it."""

    def put_forward(self, by_ns: int) -> None:
        """Do nothing: virtual time needs no correction."""

    def now_ns(self) -> int:
        return self._now_ns

    def wait_until(self, instant_ns: int) -> int:
        if instant_ns > self._now_ns:
            self._now_ns = instant_ns
        return 0


class MonotonicClock:
    """CLOCK_MONOTONIC, counted from the start of the run (before that, from the object's creation).

    Instants are absolute, so lateness in one cycle never shifts the next.

    Args:
        awake_ns: waits shorter than this are spent awake: a sleeping thread wakes at least 15 µs
            late.
    """

    def __init__(self, awake_ns: int = 0) -> None:
        self.awake_ns = awake_ns
        self._anchor_ns: int | None = None
        self.start()

    def start(self) -> None:
        self._start_ns = time.monotonic_ns() if self._anchor_ns is None else self._anchor_ns

    def anchor(self, ago_ns: int) -> None:
        self._anchor_ns = time.monotonic_ns() - ago_ns

    def put_forward(self, by_ns: int) -> None:
        self._start_ns -= by_ns

    def now_ns(self) -> int:
        return time.monotonic_ns() - self._start_ns

    def wait_until(self, instant_ns: int) -> int:
        while (remaining_ns := instant_ns - self.now_ns()) > 0:
            if remaining_ns > self.awake_ns:
                time.sleep(remaining_ns * 1e-9)
            else:
                _yield_cpu()
        return -remaining_ns


def own_kernel() -> int:
    """Return a number of the running kernel: its processes have one monotonic clock; 0: unknown."""
    with contextlib.suppress(OSError):
        return zlib.crc32(Path("/proc/sys/kernel/random/boot_id").read_bytes())
    return 0


class TickGrid:
    """The absolute grid of ticks and substeps of a run.

    Args:
        rate_hz: ticks per second.
        substeps: physics steps per tick.

    Attributes:
        period_ns: length of a tick.
        substep_s: length of a physics step.
    """

    def __init__(self, rate_hz: float, substeps: int) -> None:
        self.period_ns = round(1e9 / rate_hz)
        self.substeps = substeps
        self.substep_s = self.period_ns * 1e-9 / substeps

    def tick_ns(self, tick: int) -> int:
        return tick * self.period_ns

    def stages(self) -> tuple[range, ...]:
        """Split a tick's substeps for real time: a stage is computed when its last substep begins.

        A single stage would leave too little time before the next tick.

        Returns:
            the numbers of the substeps within the tick, stage by stage.
        """
        if self.substeps > 1:
            return range(self.substeps - 1), range(self.substeps - 1, self.substeps)
        return (range(self.substeps),)

    def substep_ns(self, number: int) -> int:
        """Return the start of a physics step; steps are numbered through the whole run."""
        return number * self.period_ns // self.substeps

    def next_substep_ns(self, instant_ns: int) -> int:
        """Return the start of the first physics step at or after an instant."""
        return self.substep_ns(-(-instant_ns * self.substeps // self.period_ns))

    def tick_at_or_before(self, instant_ns: int) -> int:
        return instant_ns // self.period_ns


_RECENTLY_NS = 1_000_000_000
_WORTH_NAMING_NS = 20_000_000


class HostLateness:
    """Largest lateness of this host within the last second."""

    def __init__(self) -> None:
        self._worst_ns, self._at_ns = 0, 0

    def note(self, late_ns: int, now_ns: int) -> None:
        """Note by how much this host is late at this time of the run."""
        if late_ns >= self._worst_ns or now_ns - self._at_ns > _RECENTLY_NS:
            self._worst_ns, self._at_ns = late_ns, now_ns

    def in_words(self, now_ns: int) -> str:
        """Explain a fault by this host's lateness; empty if this host was in time."""
        if self._worst_ns < _WORTH_NAMING_NS or now_ns - self._at_ns > _RECENTLY_NS:
            return ""
        return (
            f"this host was late by {self._worst_ns * 1e-6:.0f} ms,"
            f" {self._at_ns * 1e-9:.2f} s into the run"
        )


def utc_text(instant_ns: int) -> str:
    """Return an instant of the monotonic clock as date and time, in UTC, with microseconds."""
    ago = dt.timedelta(microseconds=(time.monotonic_ns() - instant_ns) // 1000)
    return (dt.datetime.now(dt.UTC) - ago).isoformat(timespec="microseconds")
