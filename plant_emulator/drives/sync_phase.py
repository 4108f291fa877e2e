"""Adjusts the plant's clock to the master's cycle in real time, as a drive adjusts to SYNC."""

from __future__ import annotations

_COUNTED = 25
"""Samplings of the start, whose numbers are those of the ticks they belong to."""

_WINDOW, _EARLY = 20, 2
_MOST_OF_PERIOD = 0.01
"""Largest correction of the clock by a window: 500 ppm, more than two clocks ever drift apart, and
so little that no run of samplings read late, and no second master, turns it far."""


class SyncPhase:
    """Estimates the clock's phase error from the times at which samplings were read.

    A sampling is only ever read late. So of the first ones, one that seems to come early shows that
    the clock was set too late: the sampling it was set by was held up. Later on, an early one of a
    window shows how the two clocks drift apart. One that had to wait for a busy plant came at an
    unknown instant: it counts as in time, if that is possible.

    Args:
        period_ns: of the cycle.
        lead_ns: how long after a tick its sampling is to come.
    """

    def __init__(self, period_ns: int, lead_ns: int) -> None:
        self._period_ns, self._lead_ns = period_ns, lead_ns
        self._most_ns = round(_MOST_OF_PERIOD * period_ns)
        self._count = 0
        self._late_ns: list[int] = []

    def correction_ns(self, now_ns: int, waited_ns: int = 0) -> int:
        """Return the clock correction after a sampling.

        Args:
            now_ns: clock time at which its first frame was read.
            waited_ns: the longest that this frame may have waited to be read.
        """
        period_ns = self._period_ns
        late_ns = now_ns - self._lead_ns - self._count * period_ns
        if self._count < _COUNTED:
            self._count += 1
            return max(0, -late_ns)
        late_ns = (late_ns + period_ns // 2) % period_ns - period_ns // 2
        self._late_ns.append(min(late_ns, max(0, late_ns - waited_ns)))
        if len(self._late_ns) < _WINDOW:
            return 0
        early_ns, self._late_ns = sorted(self._late_ns)[_EARLY], []
        return min(max(-early_ns, -self._most_ns), self._most_ns)
