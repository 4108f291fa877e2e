"""Driver code of others, in real time over python-can's virtual bus."""

from __future__ import annotations

import itertools
import threading
import time
from contextlib import contextmanager

import canopen
import numpy as np
import pytest
from canopen.profiles.p402 import BaseNode402

from bus_schema.can.cia402.codec import PEAK_TO_RATED
from bus_schema.can.medium import CanMedium
from bus_schema.can.session import open_can_bus
from bus_schema.link.can_configuration import CIA402_EDS, CanConfiguration
from bus_schema.runtime.clock import MonotonicClock, TickGrid
from controller.manipulator_model import ManipulatorModel
from plant_emulator.configuration import PlantConfiguration
from plant_emulator.drives.commissioning import build_bank
from plant_emulator.drives.drive_rig import DriveRig
from plant_emulator.drives.drives_on_bus import DrivenArm, DrivesOnBus
from tests.arms import PAPER_ARM
from tests.waiting import await_true

ROBOT = PAPER_ARM
START = np.array([0.2, -1.0, 0.9])
GRID = TickGrid(250.0, 8)
PLANT = PlantConfiguration()
PATIENCE_S = 60.0
NODE_ID, JOINT = 2, 1
PUSH_NM = -330.0  # the shoulder has 276 N m of gravity to bear
_CHANNELS = itertools.count()


class UnhurriedClock(MonotonicClock):
    """Time that goes slower, and stands still while the machine does.

    A rig makes up for a turn that it missed: half a second of it, and a joint that is pushed is at
    its stop before a client hears that it moves.

    Args:
        slower: how many times slower than the world's.
    """

    STRIDE_NS = GRID.period_ns

    def __init__(self, slower):
        self._slower = slower
        super().__init__()

    def start(self):
        self._read_ns, self._now_ns = time.monotonic_ns(), 0

    def now_ns(self):
        last_ns, self._read_ns = self._read_ns, time.monotonic_ns()
        self._now_ns += min((self._read_ns - last_ns) // self._slower, self.STRIDE_NS)
        return self._now_ns


class Rig:
    """Drives and physics on a thread, as `funnel-hil drives` runs them."""

    def __init__(
        self, protocol, tuned=None, slower=1, arm=(ROBOT, PLANT, START), faults=(), **given
    ):
        self.channel = f"drives{next(_CHANNELS)}"
        options = {"interface": "virtual", "channel": self.channel, "protocol": protocol, **given}
        configuration = CanConfiguration.model_validate(options)
        self._bus = open_can_bus(configuration)
        robot, plant, start = arm
        self.arm = DrivenArm(plant, robot, start, GRID, seed=1)
        drives = DrivesOnBus(
            self._bus, faults,
            lambda send: build_bank(configuration, robot, plant, send, tuned=tuned),
            CanMedium(configuration, seed=1),
        )  # fmt: skip
        self.bank, self.events = drives.bank, []
        clock = UnhurriedClock(slower)
        self._rig = DriveRig(self.arm, drives, clock, GRID, self.events.append)
        self._thread = threading.Thread(target=self._rig.run, daemon=True)

    def __enter__(self):
        self._thread.start()
        return self

    def __exit__(self, *_):
        self._rig.request_stop()
        self._thread.join(PATIENCE_S)
        self._bus.close()
        self.arm.close()


def patient_node(node_id):
    """canopen's client, which on a busy machine waits for longer than by default.

    But not to reset a fault: that long it always waits, in vain, before it goes on.
    """
    node = BaseNode402(node_id, str(CIA402_EDS))
    node.TIMEOUT_CHECK_TPDO = node.TIMEOUT_SWITCH_OP_MODE = PATIENCE_S
    node.TIMEOUT_SWITCH_STATE_FINAL = node.TIMEOUT_SWITCH_STATE_SINGLE = PATIENCE_S
    node.sdo.RESPONSE_TIMEOUT = PATIENCE_S
    return node


def assert_energy_agrees(torque_nm, position_rad, velocity_rad_s):
    """Work of motor and gravity has become kinetic energy: ½ M q̇² = ∫ (τ − G) dq.

    The other joints are held by their brakes, there is no friction, and no clock is needed.
    """
    model = ManipulatorModel(ROBOT)
    angles = np.linspace(START[JOINT], position_rad, 201)
    poses = np.tile(START, (201, 1))
    poses[:, JOINT] = angles
    gravity = np.array([model.gravity(pose)[JOINT] for pose in poses])
    work = np.trapezoid(torque_nm - gravity, angles)
    kinetic = 0.5 * model.mass_matrix(poses[-1])[JOINT, JOINT] * velocity_rad_s**2
    assert kinetic == pytest.approx(work, rel=0.02)


@contextmanager
def canopen_client(rig, node_id, mode, pdo=1):
    """A node of canopen's in a mode of operation, whose targets come with an RPDO."""
    network = canopen.Network()
    network.connect(interface="virtual", channel=rig.channel)
    try:
        node = patient_node(node_id)
        network.add_node(node)
        node.nmt.wait_for_heartbeat(PATIENCE_S)
        node.rpdo.read()
        for number in (1, pdo):
            node.rpdo[number].enabled = number == pdo
        node.rpdo.save()
        node.setup_402_state_machine()
        node.nmt.state = "OPERATIONAL"
        network.sync.start(0.01)
        node.op_mode = mode
        await_true(lambda: node.op_mode == mode)
        yield node
    finally:
        network.sync.stop()
        network.disconnect()


def test_canopen_client_enables_and_moves_a_drive_and_resets_a_fault():
    with (
        Rig("cia402", slower=4) as rig,
        canopen_client(rig, NODE_ID, "CYCLIC SYNCHRONOUS TORQUE") as node,
    ):
        node.state = "READY TO SWITCH ON"
        node.state = "SWITCHED ON"
        check_motion(node)
        check_fault(node)
    assert any(f"node {NODE_ID}: OPERATION_ENABLED" in event for event in rig.events)


def check_motion(node):
    start = START[JOINT]
    rated_nm = node.sdo[0x6076].raw * 1e-3
    assert rated_nm == pytest.approx(ROBOT.effort_limits_nm[JOINT] / PEAK_TO_RATED, rel=1e-4)
    per_mille = round(PUSH_NM / rated_nm * 1000)
    to_rad = 2 * np.pi / node.sdo[0x608F][1].raw
    node.rpdo[1]["Target torque"].raw = per_mille
    seen = []
    node.tpdo[1].add_callback(
        lambda pdo: seen.append(
            (pdo["Position actual value"].raw * to_rad, pdo["Velocity actual value"].raw * to_rad)
        )
    )
    node.state = "OPERATION ENABLED"
    moved = 0.15
    await_true(lambda: bool(seen) and abs(seen[-1][0] - start) > moved)
    position_rad, velocity_rad_s = next(row for row in seen if abs(row[0] - start) > moved)
    assert_energy_agrees(per_mille * 1e-3 * rated_nm, position_rad, velocity_rad_s)
    node.state = "SWITCHED ON"


def check_fault(node):
    """The master sends an RPDO later than its event time."""
    emergencies = []
    node.emcy.add_callback(emergencies.append)
    node.state = "OPERATION ENABLED"
    node.sdo[0x1400][5].raw = 50
    node.rpdo[1]["Target torque"].raw = 0
    node.rpdo[1].transmit()
    await_true(lambda: node.state == "FAULT")
    await_true(lambda: bool(emergencies))
    assert [error.code for error in emergencies] == [0x8250]
    node.sdo[0x1400][5].raw = 0
    node.reset_from_fault()
    assert node.state == "OPERATION ENABLED"
    assert emergencies[-1].code == 0
    node.state = "SWITCH ON DISABLED"
