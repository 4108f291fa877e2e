"""Counters of targets that a robot waits for: by time, or in a row."""

from __future__ import annotations

_ROUNDING_S = 1e-9


class Silence:
    """Time since the last target, and a time-out.

    Args:
        period_s: of a cycle.
        timeout_s: time without a target after which the robot stops.

    Attributes:
        silent_s: time since the last cycle with a target.
    """

    def __init__(self, period_s: float, timeout_s: float) -> None:
        self._period_s, self._timeout_s, self.silent_s = period_s, timeout_s, 0.0

    def start(self) -> None:
        """Begin as after a target."""
        self.silent_s = 0.0

    def note(self, *, has_target: bool) -> bool:
        """Note a cycle; return whether the robot has timed out."""
        self.silent_s = 0.0 if has_target else self.silent_s + self._period_s
        return self.silent_s >= self._timeout_s - _ROUNDING_S


class LostInARow:
    """Cycles without a target since the last one that had one.

    Args:
        most: as many in a row stop the robot.
    """

    def __init__(self, most: int) -> None:
        self._most, self._lost = most, 0

    def start(self) -> None:
        """Begin as after a target."""
        self._lost = 0

    def note(self, *, has_target: bool) -> bool:
        """Note a cycle; return whether too many targets were lost."""
        self._lost = 0 if has_target else self._lost + 1
        return self._lost >= self._most
