"""What the emulated transport does to the messages of one direction."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from typing import Generic, TypeVar

from bus_schema.link_configuration import ChannelConfiguration

Item = TypeVar("Item")

NEVER_NS = 1 << 62
"""Later than any run ends."""


@dataclass
class TransportCounts:
    """What became of the messages of one direction.

    Attributes:
        sent: handed to the channel.
        delivered: came out of it.
        lost: will never come out.
        duplicated: came out more than once.
        reordered: came out behind a younger one.
    """

    sent: int = 0
    delivered: int = 0
    lost: int = 0
    duplicated: int = 0
    reordered: int = 0


class Channel(Generic[Item]):
    """One direction of the link: what goes in at one instant comes out at another.

    Attributes:
        next_due_ns: when the next item comes out; `NEVER_NS` if nothing is on its way.
        counts: what became of the items.
    """

    def __init__(self, configuration: ChannelConfiguration) -> None:
        self._delay_ns = configuration.delay_ns
        self._in_flight: deque[tuple[int, Item]] = deque()
        self.next_due_ns = NEVER_NS
        self.counts = TransportCounts()

    def send(self, item: Item, now_ns: int) -> None:
        """Put `item` on its way at `now_ns`."""
        self.counts.sent += 1
        self._in_flight.append((now_ns + self._delay_ns, item))
        self.next_due_ns = self._in_flight[0][0]

    def receive(self) -> tuple[int, Item]:
        """The next item to come out and when it does so.

        Raises:
            IndexError: nothing is on its way.
        """
        arrival = self._in_flight.popleft()
        self.counts.delivered += 1
        self.next_due_ns = self._in_flight[0][0] if self._in_flight else NEVER_NS
        return arrival
