"""A direction of the link that delays all messages alike."""

from __future__ import annotations

from collections import Counter, deque
from typing import Generic, TypeVar

from plant_emulator.channel.transport_statistics import TransportStatistics

Item = TypeVar("Item")

NEVER_NS = 1 << 62
"""Later than any run ends."""


class Channel(Generic[Item]):
    """One direction of the link: what goes in at one instant comes out at another.

    This one delays all messages alike and does nothing else.

    Args:
        delay_ns: by how much.

    Attributes:
        next_due_ns: when the next item comes out; `NEVER_NS` if nothing is on its way.
        mean_delay_ns: what the delay's distribution says at the start of the run. Neither the
            queue of a bandwidth limit nor waiting for others counts, nor that no delay is negative.
    """

    def __init__(self, delay_ns: int) -> None:
        self._delay_ns = self.mean_delay_ns = delay_ns
        self._in_flight: deque[tuple[int, Item]] = deque()
        self._delivered = 0
        self.next_due_ns = NEVER_NS

    def send(self, item: Item, now_ns: int, size_bytes: int) -> None:  # noqa: ARG002 (for others)
        """Put `item` on its way at `now_ns`, which must not be earlier than that of the last one.

        Args:
            item: what goes in.
            now_ns: when it does so.
            size_bytes: what it takes of a limited bandwidth.
        """
        self._in_flight.append((now_ns + self._delay_ns, item))
        self.next_due_ns = self._in_flight[0][0]

    def receive(self) -> tuple[int, Item]:
        """The next item to come out and when it does so.

        Raises:
            IndexError: nothing is on its way.
        """
        arrival = self._in_flight.popleft()
        self._delivered += 1
        self.next_due_ns = self._in_flight[0][0] if self._in_flight else NEVER_NS
        return arrival

    def take_due(self, now_ns: int) -> list[tuple[int, Item]]:
        """All items that come out until `now_ns`, and when they do so, in that order."""
        due: list[tuple[int, Item]] = []
        while self.next_due_ns <= now_ns:
            due.append(self.receive())
        return due

    def statistics(self) -> TransportStatistics:
        """What became of the items."""
        return TransportStatistics(
            sent=self._delivered + len(self._in_flight),
            delivered=self._delivered,
            delays_us=Counter({(self._delay_ns + 500) // 1000: self._delivered}),
        )
