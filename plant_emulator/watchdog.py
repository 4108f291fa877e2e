"""When the arm must stop because its controller has died or fallen silent."""

from __future__ import annotations


class Watchdog:
    """Knows when the arm must stop: some time after the last valid command took effect.

    `PlantLoop` looks at it before each physics substep.

    Args:
        timeout_ns: longest silence during a run.
        first_command_ns: instant by which the first command must have taken effect.

    Attributes:
        expires_ns: the arm must stop after this instant, unless a command comes before.
    """

    def __init__(self, timeout_ns: int, first_command_ns: int) -> None:
        self._timeout_ns = timeout_ns
        self.expires_ns = first_command_ns

    def feed(self, now_ns: int) -> None:
        """A valid command took effect."""
        self.expires_ns = now_ns + self._timeout_ns
