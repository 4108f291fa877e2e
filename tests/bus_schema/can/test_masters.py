"""Masters on a failing bus: their error names the cause, not a consequence."""

from __future__ import annotations

import struct
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

from bus_schema.can.cansimple.codec import CanSimpleCodec
from bus_schema.can.cansimple.protocol import CanSimpleMaster
from bus_schema.can.cia402.codec import Cia402Codec, rated_torque_nm
from bus_schema.can.cia402.master import Cia402Master
from bus_schema.can.frame import BUS_OFF, CanFrame
from bus_schema.can.master import CanMaster, DriveError, SilentDriveError
from bus_schema.can.mit.codec import MitCodec, MitRanges
from bus_schema.can.mit.protocol import MitMaster
from bus_schema.drive_feedback import DriveGains
from bus_schema.errors import BusError
from bus_schema.link.can_configuration import CanConfiguration
from bus_schema.robot_description import load_robot
from deploy.scenario.referenced_files import find_urdf

CAN = CanConfiguration(answer_timeout_s=0.05)
NODES = (1, 2, 3)
ROBOT = load_robot(find_urdf("paper_arm", Path()))


class FrameBus:
    """Gives its frames, then fails if there is an error to fail with."""

    def __init__(self, *frames: CanFrame, error: BusError | None = None) -> None:
        self.frames, self._error = list(frames), error
        self.sent: list[CanFrame] = []

    def send(self, frame: CanFrame) -> None:
        self.sent.append(frame)

    def send_all(self, frames: Sequence[CanFrame]) -> None:
        self.sent.extend(frames)

    def receive(self, timeout_s: float) -> CanFrame | None:
        if self.frames:
            return self.frames.pop(0)
        if self._error is not None:
            raise self._error
        return None

    def close(self) -> None:
        pass


def cia402(bus: FrameBus) -> Cia402Master:
    codec = Cia402Codec(NODES, CAN.counts_per_turn, rated_torque_nm(CAN, ROBOT))
    return Cia402Master(bus, CAN, NODES, codec)


def cansimple(bus: FrameBus) -> CanMaster:
    return CanSimpleMaster(bus, CAN, NODES, CanSimpleCodec(NODES))


def mit(bus: FrameBus) -> CanMaster:
    ranges = [MitRanges(12.5, 45.0, 18.0, 500.0, 5.0)] * len(NODES)
    return MitMaster(bus, CAN, NODES, MitCodec(NODES, ranges, 0, 6))


def read(master: CanMaster) -> bool:
    return master.read(0.0, np.zeros(3), np.zeros(3))


@pytest.mark.parametrize("build", [cia402, cansimple])
def test_lost_bus_ends_enabling(build) -> None:
    booted = [CanFrame(0x700 + node, b"\0") for node in NODES]
    master = build(FrameBus(*booted, error=BusError("Network is down")))
    with pytest.raises(BusError, match="Network is down") as ended:
        master.enable(60.0, lambda: False)
    assert not isinstance(ended.value, DriveError)


@pytest.mark.parametrize("build", [cia402, cansimple])
def test_bus_off_is_an_error_except_while_stopping(build) -> None:
    bus_off = CanFrame(BUS_OFF, is_error=True)
    master = build(FrameBus(bus_off))
    master.sample(0)
    with pytest.raises(DriveError, match="the CAN controller is bus-off"):
        read(master)
    stopping = build(FrameBus(bus_off))
    stopping.sample(0)
    stopping.begin_stop()
    assert not read(stopping)


@pytest.mark.parametrize(
    ("build", "powered"),
    [
        (cia402, CanFrame(0x282, b"\x37\x02\x0a\x00\x00")),  # operation enabled
        (cansimple, CanFrame(0x041, b"\0\0\0\0\x08\0\0\0")),  # closed-loop control
    ],
)
def test_master_waits_for_missing_drive_until_it_gives_up(build, powered) -> None:
    master = build(FrameBus(powered))
    master.sample(0)
    assert not read(master)
    master.begin_stop()
    assert not master.is_stopped()
    assert not read(master)
    master.give_up()
    assert master.is_stopped()
    assert read(master)


def test_master_awaits_no_drive_that_it_gave_up() -> None:
    bus = FrameBus(CanFrame(0x049, bytes(8)))  # estimates of node 2
    master = cansimple(bus)
    assert read(master)
    master.sample(0)
    assert not read(master)
    assert master.missing() == "1, 3"
    master.give_up()
    assert read(master)
    master.sample(0)
    assert master.missing() == "2"
    master.give_up()
    master.sample(0)
    assert read(master)


@pytest.mark.parametrize(
    ("build", "frames", "words"),
    [
        (
            cia402,
            [CanFrame(0x000, b"\x81\x01"), CanFrame(0x080), CanFrame(0x080), CanFrame(0x202, b"")],
            "another master is on this bus: it sent NMT (1), SYNC (2), RPDO 1 (1)",
        ),
        (
            cansimple,
            [CanFrame(0x049, is_remote=True), CanFrame(0x04E, bytes(4))],
            "another master is on this bus: it sent requests (1), Set_Input_Torque (1)",
        ),
        (mit, [CanFrame(0x001, bytes(8))], "another master is on this bus: it sent commands (1)"),
        (
            cia402,
            [CanFrame(0x181, bytes(8)), CanFrame(0x181, bytes(8))],
            "drive 1 sent 2 states for 1 requests: another drive has its address",
        ),
        (cia402, [CanFrame(0x181, bytes(8)), CanFrame(0x204, b"")], ""),  # node 4: not of ours
        (cansimple, [CanFrame(0x049, bytes(8)), CanFrame(0x123)], ""),
    ],
)
def test_other_masters_and_drives_are_named(build, frames, words):
    master = build(FrameBus(*frames))
    master.sample(0)
    assert not read(master)
    sentence = master.strangers()
    assert words in sentence
    assert bool(words) == bool(sentence)


def test_drives_may_be_late_at_the_start_only() -> None:
    bus = FrameBus()
    master = cia402(bus)
    master._start_timeout_ms = 5000.0  # as enabling with this time for the drives to come
    late_ns = 4_000_000_000  # far beyond link.can.heartbeat_timeout_ms
    master.sample(late_ns)
    assert not read(master)
    bus.frames += [CanFrame(0x180 + node, bytes(8)) for node in NODES]
    assert read(master)
    master.sample(late_ns + 71_000_000)
    with pytest.raises(DriveError, match="drive 1: no heartbeat for 70 ms"):
        read(master)


FAULT_OF_1 = CanFrame(0x281, b"\x1f\x02\x0a\x00\x00")  # fault reaction active


def test_silent_drive_is_named_before_its_consequences() -> None:
    """The others got no torque for want of its state, and stopped for that."""
    bus = FrameBus()
    master = cia402(bus)
    for now_ms, nodes in ((10, NODES), (40, (1, 3))):
        master.sample(now_ms * 1_000_000)
        bus.frames += [CanFrame(0x180 + node, bytes(8)) for node in nodes]
        assert read(master) == (nodes == NODES)
    master.sample(62_000_000)
    bus.frames.append(FAULT_OF_1)
    with pytest.raises(SilentDriveError, match=r"^drive 2: no state for 52 ms; drive 1: fault"):
        read(master)


@pytest.mark.parametrize("nodes", [(), (1, 2, 3)])
def test_silence_of_all_drives_or_none_is_no_cause(nodes):
    bus = FrameBus()
    master = cia402(bus)
    master.sample(62_000_000)
    bus.frames += [*(CanFrame(0x180 + node, bytes(8)) for node in nodes), FAULT_OF_1]
    if nodes:
        assert read(master)
        master.sample(64_000_000)
    with pytest.raises(DriveError, match=r"^drive 1: fault reaction active$") as ended:
        read(master)
    assert not ended.value.is_cause


GAINS = DriveGains(True, np.array([20.0]), np.array([2.0]))


@pytest.mark.parametrize(
    ("codec", "state", "layout"),
    [
        (Cia402Codec([1], 1 << 20, np.ones(1), gains=GAINS), CanFrame(0x181, b"\1" * 8), "<xxi"),
        (CanSimpleCodec([1], GAINS), CanFrame(0x029, struct.pack("<ff", 0.25, 0.5)), "<f"),
    ],
)
def test_command_without_target_holds_the_last_reported_position(codec, state, layout):
    assert codec.read_state(state, np.zeros(1), np.zeros(1)) == 0
    *_, command = codec.command_frames(np.zeros(1))
    reported = struct.unpack_from(layout.replace("x", ""), state.data)
    assert struct.unpack_from(layout, command.data) == reported
