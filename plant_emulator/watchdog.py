"""The watch over commands: none for too long, and the arm has to stop."""

from __future__ import annotations


class Watchdog:
    """Counts the time since the last valid command took effect, on the plant's clock.

    Args:
        timeout_ns: longest silence during a run.
        first_command_ns: instant by which the first command must have taken effect.
    """

    def __init__(self, timeout_ns: int, first_command_ns: int) -> None:
        self._timeout_ns = timeout_ns
        self._expires_ns = first_command_ns

    def feed(self, now_ns: int) -> None:
        """A valid command took effect."""
        self._expires_ns = now_ns + self._timeout_ns

    def has_expired(self, now_ns: int) -> bool:
        return now_ns > self._expires_ns
