"""Adjusts the plant's clock to the master's cycle in real time, as a drive adjusts to SYNC."""

from __future__ import annotations

from statistics import median_low

_COUNTED = 25
"""Samplings of the start, whose numbers are those of the ticks they belong to."""

_WINDOW = 20
_MOST_OF_PERIOD = 0.01
"""What a window may move the clock by: 500 ppm, more than two clocks ever drift apart, and so
little that no run of samplings read late, and no second master, turns it far."""


class SyncPhase:
    """Estimates the clock's phase error from the times at which samplings were read.

    A sampling is only ever read late. So of the first ones, one that seems to come early shows that
    the clock was set too late: the sampling it was set by was held up. Later on, the middle one of
    a window shows how the two clocks drift apart. The window has only samplings for which the plant
    waited: one that had to wait itself says how busy the plant was, not when it came.

    Args:
        period_ns: of the cycle.
        lead_ns: how long after a tick its sampling is to come.
    """

    def __init__(self, period_ns: int, lead_ns: int) -> None:
        self._period_ns, self._lead_ns = period_ns, lead_ns
        self._most_ns = round(_MOST_OF_PERIOD * period_ns)
        self._count = 0
        self._late_ns: list[int] = []

    def correction_ns(self, now_ns: int, *, was_awaited: bool) -> int:
        """Return the clock correction after a sampling.

        Args:
            now_ns: clock time at which the first frame of it was read.
            was_awaited: it was read as it came.
        """
        period_ns = self._period_ns
        late_ns = now_ns - self._lead_ns - self._count * period_ns
        if self._count < _COUNTED:
            self._count += 1
            return max(0, -late_ns)
        if not was_awaited:
            return 0
        self._late_ns.append((late_ns + period_ns // 2) % period_ns - period_ns // 2)
        if len(self._late_ns) < _WINDOW:
            return 0
        usual_ns, self._late_ns = median_low(self._late_ns), []
        return min(max(-usual_ns, -self._most_ns), self._most_ns)
