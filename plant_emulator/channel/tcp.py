"""One direction of a link over TCP: a loss is a delay of all that follows.

Each message is a segment (TCP_NODELAY). The receiver delivers in order. The sender sends again what
is missing once three later segments have arrived, or when the timer runs out (RFC 6298 with the
least time of Linux, RFC 6675 with selective acknowledgements). Until an answer to a timer's
repetition comes, new messages wait. Not modelled: a congestion window, lost or delayed
acknowledgements, and Linux's earlier repetitions (RACK, tail loss probes).
"""

from __future__ import annotations

import heapq
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Generic, NamedTuple

import numpy as np

from bus_schema.link.channel_configuration import ChannelConfiguration
from plant_emulator.channel.channel import NEVER_NS, Item
from plant_emulator.channel.conditions import ConditionFault
from plant_emulator.channel.impairment import ImpairedChannel
from plant_emulator.channel.trace import TraceReplay

_DUPLICATE_ANSWERS = 3
LEAST_VARIATION_NS = 200_000_000
"""Linux waits so much longer than a usual round trip, or four times its variation."""
_LONGEST_NS = 120_000_000_000


class RepetitionTimer:
    """Time for which a sender waits for an acknowledgement (RFC 6298).

    Args:
        round_trip_ns: of the handshake.
    """

    def __init__(self, round_trip_ns: int) -> None:
        self._smooth_ns, self._variation_ns = float(round_trip_ns), 0.5 * round_trip_ns
        self._doublings = 0

    @property
    def wait_ns(self) -> int:
        """Time without an acknowledgement after which a segment is sent again."""
        once_ns = self._smooth_ns + max(4.0 * self._variation_ns, LEAST_VARIATION_NS)
        return int(min(once_ns * 2**self._doublings, _LONGEST_NS))

    def double(self) -> None:
        """Wait twice as long, after a repetition."""
        self._doublings = min(self._doublings + 1, 16)

    def note_progress(self) -> None:
        """Wait as long as at first, after an acknowledgement of something new."""
        self._doublings = 0

    def note(self, round_trip_ns: int) -> None:
        """Count a round trip of a segment that was sent once."""
        off_ns = abs(self._smooth_ns - round_trip_ns)
        self._variation_ns += 0.25 * (off_ns - self._variation_ns)
        self._smooth_ns += 0.125 * (round_trip_ns - self._smooth_ns)


@dataclass
class _Segment(Generic[Item]):
    """A message that was not acknowledged: when it was written, and last sent, and how often."""

    item: Item
    size_bytes: int
    written_ns: int
    sent_ns: int = 0
    times: int = 0


class _Event(NamedTuple):
    """A segment arrives, or the answer to that: up to which number all have arrived."""

    at_ns: int
    order: int
    number: int
    sent_ns: int
    is_repeated: bool
    all_below: int | None


class TcpChannel(ImpairedChannel[Item]):
    """A direction over TCP, with the delays and losses of a `ChannelConfiguration` for segments.

    Args:
        configuration: a section ``link.uplink`` or ``link.downlink``.
        seed: as for `ImpairedChannel`, as are the next two.
        replay: of its trace, if it has one.
        faults: scheduled faults of this direction.
        answer_ns: time that an acknowledgement takes back to the sender.
    """

    def __init__(
        self,
        configuration: ChannelConfiguration,
        seed: np.random.SeedSequence,
        replay: TraceReplay | None,
        faults: Sequence[ConditionFault],
        answer_ns: int,
    ) -> None:
        super().__init__(configuration, seed, replay, faults)
        self._answer_ns, self._timer_ns = answer_ns, NEVER_NS
        self._timer = RepetitionTimer(self.mean_delay_ns + answer_ns)
        self._segments: dict[int, _Segment[Item]] = {}  # not acknowledged, in order
        self._known: set[int] = set()  # of these, those that have arrived all the same
        self._events: list[_Event] = []
        self._order = self._written = self._expected = 0
        self._early: set[int] = set()  # arrived, but not all before them
        self._out: deque[tuple[int, int, int, Item]] = deque()
        self._waits = False  # for the answer to the timer's repetition
        self._statistics.resent = 0

    def send(self, item: Item, now_ns: int, size_bytes: int) -> bool:
        self._advance(now_ns)
        number, self._written = self._written, self._written + 1
        self._segments[number] = _Segment(item, size_bytes, now_ns)
        self._statistics.note_sent(is_lost=False)
        if not self._waits:
            self._transmit(number, now_ns)
        self._find_next()
        return True

    def is_due_before(self, until_ns: int) -> bool:
        while not self._out and self._next_inside_ns < until_ns:
            self._step()
        self._find_next()
        return self.next_due_ns < until_ns and bool(self._out)

    def receive(self) -> tuple[int, Item]:
        due_ns, written_ns, number, item = self._out.popleft()
        self._find_next()
        self._statistics.note_delay(written_ns, due_ns - written_ns)
        self._statistics.note_delivered(due_ns - written_ns, number, is_copy=False)
        return due_ns, item

    @property
    def _next_inside_ns(self) -> int:
        """Instant at which the next segment or answer arrives, or the timer runs out."""
        return min(self._events[0].at_ns if self._events else NEVER_NS, self._timer_ns)

    def _find_next(self) -> None:
        self.next_due_ns = self._out[0][0] if self._out else self._next_inside_ns

    def _advance(self, now_ns: int) -> None:
        """Let everything happen that comes before an instant, or at it."""
        while self._next_inside_ns <= now_ns:
            self._step()

    def _step(self) -> None:
        """Let the next thing happen."""
        if not self._events or self._timer_ns < self._events[0].at_ns:
            self._time_out(self._timer_ns)
            return
        event = heapq.heappop(self._events)
        if event.all_below is None:
            self._arrive(event)
        else:
            self._answered(event, event.all_below)

    def _transmit(self, number: int, now_ns: int) -> None:
        segment = self._segments[number]
        is_repeated = segment.times > 0
        self._statistics.resent = (self._statistics.resent or 0) + is_repeated
        segment.sent_ns, segment.times = now_ns, segment.times + 1
        item = None if is_repeated else segment.item
        due_ns, _ = self.arrivals(item, now_ns, segment.size_bytes)
        if due_ns is not None:
            self._happens(due_ns, number, now_ns, is_repeated, None)
        if self._timer_ns == NEVER_NS:
            self._timer_ns = now_ns + self._timer.wait_ns

    def _happens(
        self, at_ns: int, number: int, sent_ns: int, is_repeated: bool, all_below: int | None
    ) -> None:
        event = _Event(at_ns, self._order, number, sent_ns, is_repeated, all_below)
        self._order += 1
        heapq.heappush(self._events, event)

    def _arrive(self, event: _Event) -> None:
        """Deliver what is complete in order, and acknowledge."""
        if event.number >= self._expected:
            self._early.add(event.number)
        while self._expected in self._early:
            self._early.remove(self._expected)
            segment = self._segments[self._expected]
            self._out.append((event.at_ns, segment.written_ns, self._expected, segment.item))
            self._expected += 1
        answer_ns = event.at_ns + self._answer_ns
        self._happens(answer_ns, event.number, event.sent_ns, event.is_repeated, self._expected)

    def _answered(self, event: _Event, all_below: int) -> None:
        """Take an acknowledgement: forget what has arrived, send again what is missing."""
        if not event.is_repeated:
            self._timer.note(event.at_ns - event.sent_ns)
        done = range(next(iter(self._segments), all_below), all_below)
        self._known.add(event.number)
        self._known = {number for number in self._known if number >= all_below}
        for number in done:
            del self._segments[number]
        if done:
            self._progress(event.at_ns)
        if len(self._known) >= _DUPLICATE_ANSWERS:
            third = sorted(self._known)[-_DUPLICATE_ANSWERS]
            lost = [each for each in self._segments if each < third and each not in self._known]
            self._repeat([each for each in lost if self._segments[each].times == 1], event.at_ns)

    def _progress(self, now_ns: int) -> None:
        """Something new is acknowledged: start the timer again, and send what has waited."""
        self._timer.note_progress()
        self._timer_ns = now_ns + self._timer.wait_ns if self._segments else NEVER_NS
        if self._waits:
            self._waits = False
            for number in [each for each in self._segments if each not in self._known]:
                self._transmit(number, now_ns)

    def _time_out(self, now_ns: int) -> None:
        """Send the oldest segment again; all others wait until it is acknowledged."""
        self._timer.double()
        self._waits, self._timer_ns = True, now_ns + self._timer.wait_ns
        self._transmit(next(iter(self._segments)), now_ns)

    def _repeat(self, numbers: Sequence[int], now_ns: int) -> None:
        for number in numbers:
            self._transmit(number, now_ns)
            self._timer_ns = now_ns + self._timer.wait_ns
