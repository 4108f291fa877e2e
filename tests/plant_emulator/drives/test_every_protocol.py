"""Behaviour that the drives of all protocols have in common."""

from __future__ import annotations

import pytest
from dialects import DIALECTS, ENABLE, Mit, command
from drive_bench import MS, NODE, Bench

from bus_schema.can.frame import CanFrame
from plant_emulator.drives.drive import AT_REST, DriveFault

WITH_WATCHDOG = [name for name in DIALECTS if name != "cia402"]  # there, the master sets it
WITH_ZERO = WITH_WATCHDOG


class Talk(Bench):
    """One drive of a protocol, and its master."""

    def __init__(self, protocol: str, **settings: float) -> None:
        self.dialect: Mit = DIALECTS[protocol]
        super().__init__(self.dialect.drive, self.dialect.settings(NODE, **settings))

    def send(self, *frames: CanFrame) -> CanFrame | None:
        """Send frames; return the last answer."""
        self.take()
        for frame in frames:
            assert self.drive.receive(frame, self.now_ns)
        answers = self.take()
        return answers[-1] if answers else None

    def start(self, torque_nm: float = 0.0) -> None:
        """Enable the drive, and send a torque."""
        self.send(*self.dialect.start(NODE), self.dialect.torque(NODE, torque_nm))

    @property
    def motion(self) -> object:
        answer = self.send(self.dialect.request(NODE))
        return pytest.approx(self.dialect.motion(answer), abs=self.dialect.motion_step)

    @property
    def torque_nm(self) -> object:
        """Torque of the released joint; None at rest."""
        demand = self.drive.demand()
        if demand == AT_REST:
            return None
        return pytest.approx(demand.torque_nm, abs=self.dialect.torque_step)


@pytest.fixture(params=DIALECTS)
def talk(request: pytest.FixtureRequest) -> Talk:
    return Talk(request.param)


def test_drive_follows_torques_from_start_to_stop(talk: Talk) -> None:
    assert talk.torque_nm is None
    talk.start(5.0)
    assert talk.torque_nm == 5.0
    talk.send(talk.dialect.torque(NODE, -2.5))
    assert talk.torque_nm == -2.5
    talk.send(*talk.dialect.stop(NODE))
    assert talk.torque_nm is None
    assert talk.drive.fault is None
    talk.start(1.0)
    assert talk.torque_nm == 1.0  # not the torque from before the stop


def test_request_returns_the_motion_and_changes_nothing(talk: Talk) -> None:
    talk.start(1.0)
    talk.move(1.25, -0.5)
    targets, samplings = talk.drive.targets, talk.drive.samplings
    assert talk.motion == [1.25, -0.5]
    assert (talk.drive.targets, talk.drive.samplings) == (targets, samplings + 1)
    assert talk.torque_nm == 1.0


def test_torque_is_limited_to_the_joints_torque() -> None:
    for name, dialect in DIALECTS.items():
        talk = Talk(name, most_nm=2.0)
        talk.start()
        for sign in (1.0, -1.0):
            talk.send(dialect.torque(NODE, sign * 9.0))
            assert talk.drive.demand().torque_nm == pytest.approx(sign * 2.0)


@pytest.mark.parametrize("fault", DIALECTS["mit"].faults)
def test_fault_lasts_until_its_cause_is_gone_and_it_is_reset(talk: Talk, fault: DriveFault) -> None:
    talk.start(1.0)
    talk.drive.inject(fault, talk.now_ns)
    talk.wait(1)
    assert talk.torque_nm is None
    assert talk.drive.fault == talk.dialect.faults[fault]
    talk.start(1.0)
    assert talk.torque_nm is None
    if fault is not DriveFault.DRIVE:  # its cause ends when the power stage is off
        talk.send(*talk.dialect.reset(NODE))
        talk.start(1.0)
        assert talk.torque_nm is None
        assert talk.drive.fault == talk.dialect.faults[fault]
        talk.drive.clear(fault, talk.now_ns)
    talk.send(*talk.dialect.reset(NODE))
    assert talk.drive.fault is None
    talk.start(1.0)
    assert talk.torque_nm == 1.0


@pytest.mark.parametrize("protocol", WITH_WATCHDOG)
def test_watchdog_stops_a_drive_without_frames(protocol: str) -> None:
    talk = Talk(protocol, watchdog_ms=50.0)
    talk.wait(500)
    talk.start(5.0)
    for _ in range(3):
        talk.wait(50)
        assert talk.torque_nm == 5.0
        talk.send(talk.dialect.torque(NODE, 5.0))
    talk.wait(51)
    assert talk.torque_nm == (0.0 if protocol == "moteus" else None)
    assert talk.drive.fault == talk.dialect.timeout
    talk.send(*talk.dialect.reset(NODE))
    talk.start(1.0)
    assert (talk.drive.fault, talk.torque_nm) == (None, 1.0)


@pytest.mark.parametrize("protocol", ["cansimple", "mit", "damiao"])
def test_last_command_stays_in_force_without_watchdog(protocol: str) -> None:
    talk = Talk(protocol)
    talk.start(5.0)
    talk.drive.advance(3600 * 1000 * MS)
    assert talk.torque_nm == 5.0


@pytest.mark.parametrize("protocol", WITH_ZERO)
def test_zero_makes_positions_relative(protocol: str) -> None:
    talk = Talk(protocol)
    talk.move(1.0)
    talk.send(talk.dialect.zero(NODE))
    assert talk.motion == [0.0, 0.0]
    talk.move(1.5)
    assert talk.motion == [0.5, 0.0]


@pytest.mark.parametrize("protocol", ["mit", "damiao"])
def test_command_in_force_refers_to_the_new_zero(protocol: str) -> None:
    talk = Talk(protocol)
    talk.move(1.0)
    talk.start()
    data = command(p=0.1, kp=50.0, ranges=talk.dialect.ranges)
    for frames in ([], [CanFrame(NODE, data)]):  # the command from before, and a new one
        talk.send(CanFrame(NODE, data), talk.dialect.zero(NODE), *frames)
        assert talk.drive.demand().loop.target_rad == pytest.approx(1.1, abs=5e-4)


WORDS = {
    "mit": [
        (CanFrame(5, ENABLE), "drive 5 enable"),
        (CanFrame(5, b"\xff" * 8), "drive 5 no command"),
        (DIALECTS["mit"].torque(5, 1.0), "torque_nm 0.99"),
        (CanFrame(0, b"\x05" + bytes(7)), "reply node_id 5, position_rad"),
    ],
    "damiao": [
        (CanFrame(5, ENABLE), "drive 5 enable"),
        (CanFrame(5, b"\xff" * 8), "drive 5 no command"),
        (CanFrame(0x205, b"\0"), "drive 5 VEL: no command"),
        (CanFrame(0x205, b"\0\0\x80\x3f"), "velocity_rad_s=1.0"),
        (CanFrame(0x11, bytes(8)), "drive 5 state: AxisState(node_id=0"),
        (CanFrame(0x7FF, b"\x05\0\x33\x0a\0\0\0\0"), "drive 5 asked: read 10 0"),
    ],
    "cansimple": [
        (DIALECTS["cansimple"].torque(5, 1.5), "axis 5 Set_Input_Torque, Input_Torque 1.5"),
        (DIALECTS["cansimple"].request(5), "axis 5 Get_Encoder_Estimates asked for"),
        (
            CanFrame(5 << 5 | 0x0C, b"\0\0\0\x3f\xe8\x03\x30\xf8"),
            "axis 5 Set_Input_Pos, Input_Pos 0.5, Vel_FF 1.0, Torque_FF -2.0",
        ),
    ],
    "moteus": [
        (DIALECTS["moteus"].stop(5)[0], "drive 5 Subframe(operation=0, form=0"),
        (CanFrame(5, b"\x02"), "drive 5: the frame ends within a number"),
    ],
    "cia402": [
        (CanFrame(0, bytes([1, 0])), "NMT START all nodes"),
        (CanFrame(0x80), "SYNC"),
        (CanFrame(0x205, b"\x0f\0\xfe\xff"), "node 5 RPDO Controlword 0x000F, Target torque -2"),
        (CanFrame(0x705, b"\x05"), "node 5 heartbeat OPERATIONAL"),
        (CanFrame(0x85, b"\x30\x81\x11" + bytes(5)), "EMCY 0x8130 HEARTBEAT_LOST, register 17"),
        (
            CanFrame(0x605, b"\x2b\x5a\x60\0\x02\0\0\0"),
            "node 5 SDO download request 0x605A:00 Quick stop option code 0x2",
        ),
        (
            CanFrame(0x585, b"\x80\x60\x60\0\x30\0\x09\x06"),
            "node 5 SDO abort 0x6060:00 Modes of operation 0x6090030",
        ),
    ],
}


def test_frames_in_words(talk: Talk) -> None:
    name = next(name for name, dialect in DIALECTS.items() if dialect is talk.dialect)
    for frame, words in WORDS[name]:
        assert words in (talk.drive.describe(frame) or "")
    assert talk.drive.describe(CanFrame(0x0F, ENABLE)) is None
