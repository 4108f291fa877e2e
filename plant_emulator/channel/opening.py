"""Opens the channel of a direction of the link: the simplest one with what is configured."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from bus_schema.link.channel_configuration import ChannelConfiguration, TraceConfiguration
from bus_schema.link.configuration import LinkConfiguration
from bus_schema.runtime.randomness import generator
from plant_emulator.channel.channel import Channel, Item, TracedChannel
from plant_emulator.channel.conditions import ConditionFault
from plant_emulator.channel.delay_range import configured_delays_ns
from plant_emulator.channel.impairment import ImpairedChannel
from plant_emulator.channel.playout import PlayoutBuffer
from plant_emulator.channel.tcp import TcpChannel
from plant_emulator.channel.trace import TraceReplay
from plant_emulator.channel.trace_file import read_trace
from plant_emulator.command_gate import Command


def open_uplink(
    link: LinkConfiguration, seed: int, faults: Sequence[ConditionFault] = ()
) -> Channel[Item]:
    """Return the channel of states to the controller.

    Args:
        link: section of the scenario.
        seed: the scenario's seed.
        faults: scheduled faults of this direction.

    Raises:
        ValueError: its file of delays cannot be used.
    """
    return open_channel(link.uplink, seed, UPLINK, faults, answer_ns(link, UPLINK))


def open_downlink(
    link: LinkConfiguration, seed: int, faults: Sequence[ConditionFault] = ()
) -> Channel[Command] | PlayoutBuffer:
    """Return the channel of commands to the joints, with a play-out buffer if configured.

    Args:
        link: section of the scenario.
        seed: the scenario's seed.
        faults: scheduled faults of this direction.

    Raises:
        ValueError: its file of delays cannot be used.
    """
    back_ns = answer_ns(link, DOWNLINK)
    channel: Channel[Command] = open_channel(link.downlink, seed, DOWNLINK, faults, back_ns)
    plays_out = link.playout_ns or link.plays_automatically
    return PlayoutBuffer(channel, link.playout_ns) if plays_out else channel


def open_channel(
    configuration: ChannelConfiguration,
    seed: int,
    stream: int,
    faults: Sequence[ConditionFault] = (),
    answer_ns: int | None = None,
) -> Channel[Item]:
    """Return the simplest channel that has all configured features of a direction.

    Args:
        configuration: a section ``link.uplink`` or ``link.downlink``.
        seed: the scenario's seed.
        stream: `UPLINK` or `DOWNLINK`.
        faults: scheduled faults of this direction.
        answer_ns: over TCP, time that an acknowledgement takes; None without TCP.

    Raises:
        ValueError: its file of delays cannot be used.
    """
    if configuration.is_constant and not faults:
        return Channel(configuration.delay_ns)
    replay = _replay(configuration.trace, seed, stream)
    seeds = np.random.SeedSequence(seed, spawn_key=(stream,))
    if answer_ns is not None:
        return TcpChannel(configuration, seeds, replay, faults, answer_ns)
    without = configuration.model_copy(update={"trace": None})
    if replay is not None and without.is_constant and not (faults or configuration.reorder):
        return TracedChannel(configuration.delay_ns, replay)
    return ImpairedChannel(configuration, seeds, replay, faults)


def answer_ns(link: LinkConfiguration, stream: int) -> int | None:
    """Return the usual delay of acknowledgements of a direction; None without TCP.

    Args:
        link: section of the scenario.
        stream: `UPLINK` or `DOWNLINK`.

    Raises:
        ValueError: the file of delays of the way back cannot be used.
    """
    if link.transport != "tcp":
        return None
    delays_ns = configured_delays_ns(link.downlink if stream == UPLINK else link.uplink)
    return int(delays_ns[len(delays_ns) // 2])


def _replay(trace: TraceConfiguration | None, seed: int, stream: int) -> TraceReplay | None:
    """Return the trace of a direction; both halves of round trips start at the same time."""
    if trace is None:
        return None
    is_halved = read_trace(Path(trace.file)).is_round_trip
    seeds = np.random.SeedSequence(seed, spawn_key=(UPLINK if is_halved else stream,)).spawn(6)
    replay = TraceReplay(trace, generator(seeds[5]))
    replay.is_second_half = is_halved and stream == DOWNLINK
    return replay


UPLINK, DOWNLINK = 100, 101
"""Keys that separate the random streams of the two directions and of the arm."""
