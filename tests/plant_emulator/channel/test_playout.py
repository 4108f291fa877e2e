"""The play-out buffer: a torque acts at the stamp it answers plus a constant."""

import numpy as np

from bus_schema.link.configuration import LinkConfiguration
from plant_emulator.channel.channel import NEVER_NS, Channel
from plant_emulator.channel.opening import open_downlink
from plant_emulator.channel.playout import PlayoutBuffer
from plant_emulator.command_gate import Command

MS = 1_000_000


def command(stamp_ms):
    return Command(np.zeros(3), sequence=stamp_ms + 1, stamp_ns=stamp_ms * MS)


def released(buffer, until_ns=NEVER_NS - 1):
    return [(out_ns / MS, com.stamp_ns / MS) for out_ns, com in buffer.take_due(until_ns)]


def buffered(*commands_at_ms, playout_ms=10, delay_ms=2):
    """A buffer into which commands of these stamps were sent at these times."""
    buffer = PlayoutBuffer(Channel(delay_ms * MS), playout_ms * MS)
    for stamp_ms, now_ms in commands_at_ms:
        buffer.send(command(stamp_ms), now_ms * MS, 100)
    return buffer


def test_without_playout_there_is_no_buffer():
    assert isinstance(open_downlink(LinkConfiguration(), 1), Channel)
    assert isinstance(open_downlink(LinkConfiguration(playout_ms=1), 1), PlayoutBuffer)


def test_command_acts_at_its_stamp_plus_playout_or_on_arrival_if_that_is_later():
    buffer = buffered((0, 3), (1, 8), (2, 15))
    assert released(buffer) == [(10, 0), (11, 1), (17, 2)]
    assert buffer.statistics().delivered == 3


def test_nothing_acts_before_its_time():
    buffer = buffered((0, 3))
    assert buffer.next_due_ns == 5 * MS  # it arrives, and waits
    assert released(buffer, 5 * MS) == []
    assert buffer.next_due_ns == 10 * MS
    assert released(buffer, 10 * MS - 1) == []
    assert released(buffer, 10 * MS) == [(10, 0)]
    assert buffer.next_due_ns == NEVER_NS


def test_commands_that_overtook_each_other_are_put_in_order():
    link = LinkConfiguration(
        downlink={"delay_ms": 3, "jitter_ms": 3, "reorder": True, "duplicate": 0.2}, playout_ms=7
    )
    buffer = open_downlink(link, 1)
    for stamp_ms in range(1000):
        buffer.send(command(stamp_ms), stamp_ms * MS, 100)
    out = released(buffer)
    assert len(out) > 1100  # copies included
    assert buffer.statistics().reordered > 100
    assert {out_ms - stamp_ms for out_ms, stamp_ms in out} == {7.0}
    assert [stamp_ms for _, stamp_ms in out] == sorted(stamp_ms for _, stamp_ms in out)
