"""What the emulated transport does to the messages of one direction.

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
from bus_schema.link.configuration import LinkConfiguration
from plant_emulator.channel.channel import NEVER_NS, Channel, Item
from plant_emulator.channel.jitter import Jitter
from plant_emulator.channel.loss import Loss
from plant_emulator.channel.playout import PlayoutBuffer
from plant_emulator.channel.random_numbers import uniform_numbers
from plant_emulator.channel.schedule import ConditionFault, Conditions, Schedule
from plant_emulator.channel.transport_statistics import TransportStatistics
from plant_emulator.command_gate import Command


class _Flight(NamedTuple):
    """A message on its way: its number in the order of sending, and when that was."""

    number: int
    sent_ns: int
    is_copy: bool


class ImpairedChannel(Channel[Item]):
    """A channel with everything that a `ChannelConfiguration` can ask for.

    Args:
        configuration: a section ``link.uplink`` or ``link.downlink``.
        seed: seed of everything random here.
        faults: scheduled faults of this direction.
    """

    def __init__(
        self,
        configuration: ChannelConfiguration,
        seed: np.random.SeedSequence,
        faults: Sequence[ConditionFault] = (),
    ) -> None:
        super().__init__(configuration.delay_ns)
        randoms = [np.random.default_rng(child) for child in seed.spawn(5)]
        self._jitter, self._copys_jitter = (Jitter(configuration, r) for r in randoms[:2])
        self._loss = Loss(randoms[2], randoms[3])
        self._duplicate_numbers = uniform_numbers(randoms[4])
        self._schedule = Schedule(configuration, faults)
        self._may_overtake = configuration.reorder
        self._flying: list[tuple[int, int, _Flight, Item]] = []
        self._entered = self._latest_due_ns = self._bandwidth_free_ns = 0
        self._newest_out = -1
        self._statistics = TransportStatistics()
        start = self._schedule.at(0)
        self.mean_delay_ns = round(start.delay_ns + self._jitter.mean * start.jitter_ns)

    def send(self, item: Item, now_ns: int, size_bytes: int) -> None:
        conditions = self._schedule.at(now_ns)
        jitter = self._jitter.draw(conditions.correlation)
        is_lost = self._loss.takes(conditions)
        is_doubled = next(self._duplicate_numbers) < conditions.duplicate
        flight = _Flight(self._statistics.sent, now_ns, is_copy=False)
        self._statistics.note_sent(is_lost=is_lost)
        if is_lost:
            return
        self._launch(item, flight, self._due_ns(conditions, jitter, now_ns, size_bytes))
        if is_doubled:
            jitter = self._copys_jitter.draw(0.0)
            copy = flight._replace(is_copy=True)
            self._launch(item, copy, self._due_ns(conditions, jitter, now_ns, size_bytes))

    def receive(self) -> tuple[int, Item]:
        due_ns, _, flight, item = heapq.heappop(self._flying)
        self.next_due_ns = self._flying[0][0] if self._flying else NEVER_NS
        statistics = self._statistics
        statistics.note_delivered(due_ns - flight.sent_ns)
        if flight.is_copy:
            statistics.duplicated += 1
        elif flight.number < self._newest_out:
            statistics.reordered += 1
        self._newest_out = max(self._newest_out, flight.number)
        return due_ns, item

    def statistics(self) -> TransportStatistics:
        return self._statistics

    def _launch(self, item: Item, flight: _Flight, due_ns: int) -> None:
        heapq.heappush(self._flying, (due_ns, self._entered, flight, item))
        self._entered += 1
        self.next_due_ns = self._flying[0][0]

    def _due_ns(self, conditions: Conditions, jitter: float, now_ns: int, size_bytes: int) -> int:
        """When a message comes out; it passes the limited bandwidth first, then it is delayed."""
        passed_ns = max(now_ns, self._bandwidth_free_ns)
        passed_ns += round(size_bytes * conditions.ns_per_byte)
        self._bandwidth_free_ns = passed_ns
        delay_ns = max(0, round(conditions.delay_ns + conditions.jitter_ns * jitter))
        due_ns = passed_ns + delay_ns
        if not self._may_overtake:
            due_ns = self._latest_due_ns = max(due_ns, self._latest_due_ns)
        return due_ns


def open_uplink(
    link: LinkConfiguration, seed: int, faults: Sequence[ConditionFault] = ()
) -> Channel[Item]:
    """The way of states to the controller.

    Args:
        link: section of the scenario.
        seed: the scenario's seed.
        faults: scheduled faults of this direction.

    Raises:
        ValueError: its file of delays cannot be used.
    """
    return _open(link.uplink, seed, _UPLINK, faults)


def open_downlink(
    link: LinkConfiguration, seed: int, faults: Sequence[ConditionFault] = ()
) -> Channel[Command] | PlayoutBuffer:
    """The way of commands to the joints, with a play-out buffer where one is asked for.

    Args:
        link: section of the scenario.
        seed: the scenario's seed.
        faults: scheduled faults of this direction.

    Raises:
        ValueError: its file of delays cannot be used.
    """
    channel: Channel[Command] = _open(link.downlink, seed, _DOWNLINK, faults)
    return PlayoutBuffer(channel, link.playout_ns) if link.playout_ns else channel


def _open(
    configuration: ChannelConfiguration, seed: int, stream: int, faults: Sequence[ConditionFault]
) -> Channel[Item]:
    if configuration.is_constant and not faults:
        return Channel(configuration.delay_ns)
    return ImpairedChannel(configuration, np.random.SeedSequence(seed, spawn_key=(stream,)), faults)


_UPLINK, _DOWNLINK = 100, 101
"""Keys that keep the random streams of the directions apart from each other and from the arm's."""
