"""Clocks of a run: time since its start in whole nanoseconds, virtual or monotonic."""

from __future__ import annotations

import ctypes
import time
from typing import Protocol

_yield_cpu = ctypes.CDLL(None).sched_yield
"""Lets others of the same priority run; Python's own keeps its lock meanwhile."""


class Clock(Protocol):
    """What a loop may ask of time.

    Attributes:
        awake_ns: what is no further ahead is waited for awake.
    """

    awake_ns: int

    def start(self) -> None:
        """The run starts now: time is 0."""

    def anchor(self, ago_ns: int) -> None:
        """Note that the run began `ago_ns` ago, by a sign from outside: `start` sets time 0 there.

        Until `start`, time goes on as before. Virtual time begins with `start` whatever was noted.
        """

    def put_forward(self, by_ns: int) -> None:
        """It is later than the clock says, by so much; a little earlier if negative.

        Virtual time is what its owner makes it.
        """

    def now_ns(self) -> int:
        """Time since the start of the run."""

    def wait_until(self, instant_ns: int) -> int:
        """Return at `instant_ns` or as soon after it as possible; the lateness in ns."""


class VirtualClock:
    """Time that passes only when its owner waits: never late, whatever the machine does."""

    awake_ns = 0

    def __init__(self) -> None:
        self._now_ns = 0

    def start(self) -> None:
        self._now_ns = 0

    def anchor(self, ago_ns: int) -> None:
        """Virtual time begins when its owner starts it."""

    def put_forward(self, by_ns: int) -> None:
        """Virtual time is never wrong."""

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
        awake_ns: what is no further ahead is waited for awake. A sleeping thread comes some 15 µs
            late, at best.
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
        """How substeps are gone through in real time: each stage once its last one has begun.

        One stage of all of them would leave too little time for them before the tick.

        Returns:
            the numbers of the substeps within the tick, stage by stage.
        """
        if self.substeps > 1:
            return range(self.substeps - 1), range(self.substeps - 1, self.substeps)
        return (range(self.substeps),)

    def substep_ns(self, number: int) -> int:
        """Start of a physics step, all those of the run numbered through."""
        return number * self.period_ns // self.substeps

    def tick_at_or_before(self, instant_ns: int) -> int:
        return instant_ns // self.period_ns
