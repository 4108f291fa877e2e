"""Lateness of this host, as a possible cause of real-time faults."""

from __future__ import annotations

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
            f"this host was not running for {self._worst_ns * 1e-6:.0f} ms,"
            f" {self._at_ns * 1e-9:.2f} s into the run"
        )
