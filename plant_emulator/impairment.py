"""What the emulated transport does to the messages of one direction."""

from __future__ import annotations

from collections import Counter, deque
from dataclasses import dataclass, field
from typing import Any, Generic, TypeVar

from bus_schema.link_configuration import ChannelConfiguration

Item = TypeVar("Item")


@dataclass
class TransportCounts:
    """What became of the messages of one direction.

    Attributes:
        sent: handed to the channel.
        delivered: came out of it.
        lost: will never come out.
        duplicated: came out more than once.
        reordered: came out behind a younger one.
        rejected: not let into the channel because they were invalid, by reason.
    """

    sent: int = 0
    delivered: int = 0
    lost: int = 0
    duplicated: int = 0
    reordered: int = 0
    rejected: Counter[str] = field(default_factory=Counter)

    def as_dict(self) -> dict[str, Any]:
        return {**vars(self), "rejected": dict(self.rejected)}


class Channel(Generic[Item]):
    """One direction of the link: what goes in at one instant comes out at another."""

    def __init__(self, configuration: ChannelConfiguration) -> None:
        self._delay_ns = configuration.delay_ns
        self._in_flight: deque[tuple[int, Item]] = deque()
        self.counts = TransportCounts()

    def send(self, item: Item, now_ns: int) -> None:
        """Put `item` on its way at `now_ns`."""
        self.counts.sent += 1
        self._in_flight.append((now_ns + self._delay_ns, item))

    def next_due_ns(self) -> int | None:
        """When the next item comes out; None if nothing is on its way."""
        return self._in_flight[0][0] if self._in_flight else None

    def receive(self) -> tuple[int, Item]:
        """The next item to come out and when it does so.

        Raises:
            IndexError: nothing is on its way.
        """
        self.counts.delivered += 1
        return self._in_flight.popleft()
