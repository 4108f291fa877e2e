"""One direction of the link with a constant delay."""

from __future__ import annotations

from array import array
from collections import Counter, deque
from dataclasses import dataclass, field
from typing import Any, Generic, TypeVar

import numpy as np

from bus_schema.arrays import percentiles
from plant_emulator.channel.trace import TraceReplay, curves
from plant_emulator.channel.trace_file import LOST_NS

_FEWEST_IN_CURVES = 10


@dataclass
class TransportStatistics:
    """Counts of one direction.

    Attributes:
        sent: messages handed to the channel.
        delivered: messages that came out of it, copies included.
        lost: messages that never come out.
        duplicated: copies that came out.
        reordered: messages that came out behind a younger one.
        loss_bursts: unbroken runs of lost messages.
        longest_loss_burst: messages in the longest of them.
        resent: messages sent again, with TCP; None for other transports.
        delays_us: number of deliveries by delay, in whole µs.
        trace: the trace that the channel replays, if it has one.
    """

    sent: int = 0
    delivered: int = 0
    lost: int = 0
    duplicated: int = 0
    reordered: int = 0
    loss_bursts: int = 0
    longest_loss_burst: int = 0
    resent: int | None = None
    delays_us: Counter[int] = field(default_factory=Counter)
    trace: TraceReplay | None = None
    _sent_ns: array[int] = field(default_factory=lambda: array("q"))
    _delays_ns: array[int] = field(default_factory=lambda: array("q"))
    _burst: int = 0
    _newest: int = -1

    def note_sent(self, *, is_lost: bool) -> None:
        """Count a message that enters the channel."""
        self.sent += 1
        if not is_lost:
            self._burst = 0
            return
        self.lost += 1
        self.loss_bursts += self._burst == 0
        self._burst += 1
        self.longest_loss_burst = max(self.longest_loss_burst, self._burst)

    def note_delay(self, sent_ns: int, delay_ns: int) -> None:
        """Store the delay of a message (`LOST_NS` if lost) for the comparison with a trace."""
        if self.trace is not None:
            self._sent_ns.append(sent_ns)
            self._delays_ns.append(delay_ns)

    def note_delivered(self, delay_ns: int, number: int, *, is_copy: bool) -> None:
        """Count a delivered message.

        Args:
            delay_ns: time from entering the channel to coming out of it.
            number: of the message, in the order of sending.
            is_copy: whether it is the second one of its number.
        """
        self.delivered += 1
        self.delays_us[(delay_ns + 500) // 1000] += 1
        if is_copy:
            self.duplicated += 1
        elif number < self._newest:
            self.reordered += 1
        self._newest = max(self._newest, number)

    def summary(self) -> dict[str, Any]:
        """Return the section of ``summary.json`` for this direction; null for missing values.

        ``delay_ms`` is the time from entering the channel to coming out of it. A channel with a
        trace also has `curves` of what it did, and of what the trace says.
        """
        mean_burst = self.lost / self.loss_bursts if self.loss_bursts else None
        counts = ("sent", "delivered", "lost", "duplicated", "reordered")
        return {
            **{name: getattr(self, name) for name in counts},
            "delay_ms": self._delay_ms(),
            "loss_burst": {"mean": mean_burst, "longest": self.longest_loss_burst},
            **({} if self.resent is None else {"resent": self.resent}),
            **self._beside_trace(),
        }

    def _beside_trace(self) -> dict[str, Any]:
        if self.trace is None or len(self._sent_ns) < _FEWEST_IN_CURVES:
            return {}
        span_ns = self._sent_ns[-1] - self._sent_ns[0]
        period_ns = max(1, round(span_ns / (len(self._sent_ns) - 1)))
        did = np.array(self._delays_ns, dtype=np.int64)
        series = {"did": did, "trace": self.trace.sampled(period_ns)}
        found = {name: curves(delays, period_ns * 1e-9) for name, delays in series.items()}
        return {"curves": found}

    def _delay_ms(self) -> dict[str, float | None]:
        delays_us = np.array(list(self.delays_us))
        counts = np.array(list(self.delays_us.values()))
        mean = float(delays_us @ counts) / self.delivered / 1000 if self.delivered else None
        return {"mean": mean, **percentiles(delays_us / 1000, counts)}


Item = TypeVar("Item")

NEVER_NS = 1 << 62
"""Later than any run ends."""


class Channel(Generic[Item]):
    """One direction of the link: it delivers each item some time after it was sent.

    This one delays all messages alike and does nothing else.

    Args:
        delay_ns: by how much.

    Attributes:
        next_due_ns: no item comes out before; `NEVER_NS` if nothing is on its way.
        mean_delay_ns: what the delay's distribution says at the start of the run. Neither the
            queue of a bandwidth limit nor waiting for others counts, nor that no delay is negative.
            A pattern counts with its largest delay.
    """

    def __init__(self, delay_ns: int) -> None:
        self._delay_ns = self.mean_delay_ns = delay_ns
        self._in_flight: deque[tuple[int, Item]] = deque()
        self._delivered = 0
        self.next_due_ns = NEVER_NS

    def send(self, item: Item, now_ns: int, size_bytes: int) -> bool:  # noqa: ARG002 (for others)
        """Send `item` at `now_ns`, which must not decrease between calls.

        Args:
            item: what goes in.
            now_ns: when it does so.
            size_bytes: what it takes of a limited bandwidth.

        Returns:
            whether it comes out; otherwise it is lost.
        """
        self._in_flight.append((now_ns + self._delay_ns, item))
        self.next_due_ns = self._in_flight[0][0]
        return True

    def receive(self) -> tuple[int, Item]:
        """Return the next item to be delivered, and its time.

        Raises:
            IndexError: nothing is on its way.
        """
        arrival = self._in_flight.popleft()
        self._delivered += 1
        self.next_due_ns = self._in_flight[0][0] if self._in_flight else NEVER_NS
        return arrival

    def take_due(self, now_ns: int) -> list[tuple[int, Item]]:
        """Return all items to be delivered until `now_ns` and their times, in that order."""
        due: list[tuple[int, Item]] = []
        while self.is_due_before(now_ns + 1):
            due.append(self.receive())
        return due

    def is_due_before(self, until_ns: int) -> bool:
        """Whether `receive` has an item before an instant, until which nothing more is sent."""
        return self.next_due_ns < until_ns

    def statistics(self) -> TransportStatistics:
        """Counts of sent, delivered and lost items."""
        return TransportStatistics(
            sent=self._delivered + len(self._in_flight),
            delivered=self._delivered,
            delays_us=Counter({(self._delay_ns + 500) // 1000: self._delivered}),
        )


class TracedChannel(Channel[Item]):
    """A direction that gives messages the delays and losses of a trace, and keeps their order.

    Args:
        delay_ns: added to all delays.
        replay: of the trace.
    """

    def __init__(self, delay_ns: int, replay: TraceReplay) -> None:
        super().__init__(delay_ns)
        self.mean_delay_ns += replay.mean_delay_ns
        self._replay, self._latest_due_ns = replay, 0
        self._sent_ns, self._delays_ns = array("q"), array("q")

    def send(self, item: Item, now_ns: int, size_bytes: int) -> bool:  # noqa: ARG002 (for others)
        traced_ns = self._replay.delay_ns(now_ns, item)
        self._sent_ns.append(now_ns)
        if traced_ns is None:
            self._delays_ns.append(LOST_NS)
            return False
        due_ns = max(now_ns, now_ns + self._delay_ns + traced_ns, self._latest_due_ns)
        self._latest_due_ns = due_ns
        self._delays_ns.append(due_ns - now_ns)
        self._in_flight.append((due_ns, item))
        self.next_due_ns = self._in_flight[0][0]
        return True

    def statistics(self) -> TransportStatistics:
        """Counts of the items, computed here because it would take time on sending."""
        found = TransportStatistics(trace=self._replay)
        left = self._delivered
        for number, sent_ns in enumerate(self._sent_ns):
            delay_ns = self._delays_ns[number]
            found.note_sent(is_lost=delay_ns < 0)
            found.note_delay(sent_ns, delay_ns)
            if delay_ns >= 0 and left:
                found.note_delivered(delay_ns, number, is_copy=False)
                left -= 1
        return found
