"""Impairs the messages of one direction: delay, jitter, loss, bandwidth, order.

All is decided when a message is sent: random numbers are drawn per message in the order of sending,
each feature from a stream of its own, whether it is in use or not. So switching one feature on
leaves what the others draw as it was, and runs that differ in one value are comparable.
"""

from __future__ import annotations

import heapq
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from bus_schema.link.channel_configuration import ChannelConfiguration
from bus_schema.runtime.randomness import report_use
from plant_emulator.channel.channel import (
    NEVER_NS,
    Channel,
    Item,
    TransportStatistics,
)
from plant_emulator.channel.conditions import ConditionFault, Conditions, ConditionsSchedule
from plant_emulator.channel.jitter import Jitter, endless
from plant_emulator.channel.trace import TraceReplay
from plant_emulator.channel.trace_file import LOST_NS


class Loss:
    """Losses, independent and in bursts, each with its own random numbers.

    Bursts are Gilbert–Elliott's: whether a message is lost depends on the chain's state, and then
    the chain takes a step. It starts in the good state. Mean loss is (p (1-h) + r (1-k)) / (p + r);
    with 1-h = 1 and 1-k = 0 bursts have 1 / r messages on average.
    """

    def __init__(self, random: np.random.Generator, burst_random: np.random.Generator) -> None:
        self._numbers = endless(random.random)
        self._burst_numbers = endless(burst_random.random)
        self._is_bad = False

    def loses_next(self, conditions: Conditions) -> bool:
        """Whether the next message is lost."""
        loss_in_state = conditions.loss_in_bad if self._is_bad else conditions.loss_in_good
        is_lost_in_burst = next(self._burst_numbers) < loss_in_state
        leaves_state = conditions.r if self._is_bad else conditions.p
        if next(self._burst_numbers) < leaves_state:
            self._is_bad = not self._is_bad
        return next(self._numbers) < conditions.loss or is_lost_in_burst


class _Transit(NamedTuple):
    """A message in transit: its number in the order of sending, and its send time.

    No two are equal, so of messages due at once the one that was sent first comes out first.
    """

    number: int
    sent_ns: int
    is_copy: bool


class ImpairedChannel(Channel[Item]):
    """A channel with all features of a `ChannelConfiguration`.

    Args:
        configuration: a section ``link.uplink`` or ``link.downlink``.
        seed: seed of everything random here, but of the trace.
        replay: of its trace, if it has one.
        faults: scheduled faults of this direction.
    """

    def __init__(
        self,
        configuration: ChannelConfiguration,
        seed: np.random.SeedSequence,
        replay: TraceReplay | None = None,
        faults: Sequence[ConditionFault] = (),
    ) -> None:
        super().__init__(configuration.delay_ns)
        randoms = [np.random.default_rng(child) for child in seed.spawn(5)]
        self._jitter, self._copy_jitter = (Jitter(configuration, r) for r in randoms[:2])
        self._loss = Loss(randoms[2], randoms[3])
        self._duplicate_numbers = endless(randoms[4].random)
        self._trace = replay
        self._schedule = ConditionsSchedule(configuration, faults)
        self._may_overtake = configuration.reorder
        self._under_way: list[tuple[int, _Transit, Item]] = []
        self._latest_due_ns = self._bandwidth_free_ns = 0
        self._statistics = TransportStatistics(trace=self._trace)
        self._is_random = False
        report_use(lambda: self._is_random)
        largest = configuration.model_copy(update={"pattern": None})
        start = ConditionsSchedule(largest, faults).at(0)
        mean_ns = 0 if self._trace is None else self._trace.mean_delay_ns
        self.mean_delay_ns = round(mean_ns + start.delay_ns + self._jitter.mean * start.jitter_ns)

    def send(self, item: Item, now_ns: int, size_bytes: int) -> bool:
        statistics = self._statistics
        due_ns, copy_due_ns = self.arrivals(item, now_ns, size_bytes)
        transit = _Transit(statistics.sent, now_ns, is_copy=False)
        statistics.note_sent(is_lost=due_ns is None)
        if due_ns is None:
            statistics.note_delay(now_ns, LOST_NS)
            return False
        statistics.note_delay(now_ns, due_ns - now_ns)
        self._dispatch(item, transit, due_ns)
        if copy_due_ns is not None:
            self._dispatch(item, transit._replace(is_copy=True), copy_due_ns)
        return True

    def arrivals(
        self, item: Item | None, now_ns: int, size_bytes: int
    ) -> tuple[int | None, int | None]:
        """Return when a message that is sent now arrives, and its copy; None for what does not.

        Args:
            item: the message; None for one that was sent before.
            now_ns: when it is sent, which must not decrease between calls.
            size_bytes: what it takes of a limited bandwidth.
        """
        conditions = self._schedule.at(now_ns)
        self._is_random = self._is_random or conditions.is_random
        jitter = self._jitter.draw(conditions.correlation)
        is_lost = self._loss.loses_next(conditions)
        is_doubled = next(self._duplicate_numbers) < conditions.duplicate
        traced_ns = 0
        if self._trace is not None:
            found_ns = self._trace.delay_ns(now_ns, item)
            is_lost = is_lost or found_ns is None
            traced_ns = found_ns or 0
        if is_lost:
            return None, None
        due_ns = self._due_ns(conditions, jitter, traced_ns, now_ns, size_bytes)
        if not is_doubled:
            return due_ns, None
        jitter = self._copy_jitter.draw(0.0)
        return due_ns, self._due_ns(conditions, jitter, traced_ns, now_ns, size_bytes)

    def receive(self) -> tuple[int, Item]:
        due_ns, transit, item = heapq.heappop(self._under_way)
        self.next_due_ns = self._under_way[0][0] if self._under_way else NEVER_NS
        delay_ns = due_ns - transit.sent_ns
        self._statistics.note_delivered(delay_ns, transit.number, is_copy=transit.is_copy)
        return due_ns, item

    def statistics(self) -> TransportStatistics:
        return self._statistics

    def _dispatch(self, item: Item, transit: _Transit, due_ns: int) -> None:
        heapq.heappush(self._under_way, (due_ns, transit, item))
        self.next_due_ns = self._under_way[0][0]

    def _due_ns(
        self,
        conditions: Conditions,
        jitter: float,
        traced_ns: int,
        now_ns: int,
        size_bytes: int,
    ) -> int:
        """Return the delivery time of a message: after the limited bandwidth, then the delay."""
        passed_ns = max(now_ns, self._bandwidth_free_ns)
        passed_ns += round(size_bytes * conditions.ns_per_byte)
        self._bandwidth_free_ns = passed_ns
        added_ns = conditions.jitter_ns * jitter
        delay_ns = max(0, round(conditions.delay_ns + added_ns + traced_ns))
        due_ns = passed_ns + delay_ns
        if not self._may_overtake:
            due_ns = self._latest_due_ns = max(due_ns, self._latest_due_ns)
        return due_ns
