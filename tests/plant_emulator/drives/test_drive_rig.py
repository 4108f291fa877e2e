"""Drives and physics alone: brakes of each joint, and a bus that never falls silent."""

import numpy as np
import pytest

from bus_schema.can.frame import CanBus, CanFrame
from bus_schema.can.medium import CanMedium
from bus_schema.link.can_configuration import CanConfiguration
from bus_schema.runtime.clock import MonotonicClock, TickGrid, VirtualClock
from plant_emulator.configuration import PlantConfiguration
from plant_emulator.drives.commissioning import build_bank
from plant_emulator.drives.drive_rig import DriveRig
from plant_emulator.drives.drives_on_bus import DrivenArm, DrivesOnBus
from plant_emulator.drives.fault_plan import parse_fault
from tests.arms import PAPER_ARM

ROBOT = PAPER_ARM
START = np.array([0.2, -1.0, 0.9])
GRID = TickGrid(250.0, 8)
PLANT = PlantConfiguration()
NODES = (1, 2, 3)
ENABLE_2 = [
    None,  # the drives boot
    CanFrame(0, b"\1\2"), CanFrame(0x302, b"\x0a"), CanFrame(0x202, b"\6\0\0\0"),
    CanFrame(0x202, b"\7\0\0\0"), CanFrame(0x202, b"\x0f\0\0\0"),
]  # fmt: skip


pytestmark = pytest.mark.usefixtures("engine")


class ScriptedBus(CanBus):
    """Gives one frame per tick of a clock that it moves itself."""

    def __init__(self, clock, frames):
        self._clock, self._frames = clock, list(frames)

    def send(self, frame):
        pass

    def receive(self, timeout_s):
        self._clock.wait_until(self._clock.now_ns() + round(timeout_s * 1e9))
        return self._frames.pop(0) if self._frames else None

    def close(self):
        pass


class FloodedBus(ScriptedBus):
    """Has always one more frame."""

    received = 0

    def __init__(self):
        super().__init__(None, ())

    def receive(self, timeout_s):
        self.received += 1
        return CanFrame(0x7F3, bytes(8))


@pytest.fixture
def make():
    arms = []

    def build(bus, clock, faults=()):
        arm = DrivenArm(PLANT, ROBOT, START, GRID, seed=1)
        arms.append(arm)
        can = CanConfiguration()
        plan = [parse_fault(text, NODES) for text in faults]
        drives = DrivesOnBus(
            bus, plan, lambda send: build_bank(can, ROBOT, PLANT, send), CanMedium(can, seed=1)
        )
        events = []
        return DriveRig(arm, drives, clock, GRID, events.append), arm, drives.bank, events

    yield build
    for arm in arms:
        arm.close()


def test_a_joint_falls_when_its_own_drive_lets_go_and_no_other_does(make):
    clock = VirtualClock()
    rig, arm, bank, events = make(ScriptedBus(clock, ENABLE_2), clock)
    rig.run(100)
    assert (rig.ticks, rig.skipped) == (100, 0)
    assert bank.braked.tolist() == [True, False, True]
    moved = np.abs(arm.position - START)
    # The shoulder falls freely for 0.37 s, at first with 276 N m over 24 kg m²: over half a rad.
    assert moved[1] > 0.4
    assert moved[[0, 2]].max() < 0.01
    assert "node 2: OPERATION_ENABLED" in events


def test_a_fault_engages_the_brake_again(make):
    clock = VirtualClock()
    rig, arm, bank, events = make(ScriptedBus(clock, ENABLE_2), clock, ["drive:2@100ms"])
    rig.run(100)
    assert "node 2: OPERATION_ENABLED" in events
    assert bank.braked.all()
    assert np.abs(arm.velocity).max() < 0.01
    assert "drive injected at node 2" in events


def test_under_a_flood_the_physics_keep_their_time_and_nothing_moves(make):
    bus = FloodedBus()
    rig, arm, bank, _ = make(bus, MonotonicClock())
    rig.run(50)
    assert rig.ticks >= 50
    assert bank.rejections.counts == {"unknown_identifier": bus.received}
    assert bank.braked.all()
    assert not bank.torque_nm.any()
    assert np.abs(arm.position - START).max() < 1e-3
