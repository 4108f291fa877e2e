"""What an MJCF file says of its actuators reaches the drives, as a client reads it from them."""

from __future__ import annotations

import struct
from pathlib import Path

import pytest

from bus_schema.can.damiao.codec import DamiaoRegister, RegisterFrame, Request, register_frame
from bus_schema.can.frame import CanFrame
from bus_schema.link.can_configuration import CanConfiguration
from deploy.scenario.scenario import load_setup
from deploy.scenario.setup import Setup
from plant_emulator.drives.commissioning import build_bank

ARM = """
<mujoco>
  <compiler angle="radian"/>
  <worldbody>
    <body name="b">
      <joint name="j" axis="0 1 0"/>
      <geom type="capsule" fromto="0 0 0 0 0 0.4" size="0.05"/>
    </body>
  </worldbody>
  <actuator>
    <position joint="j" gear="2" kp="80" kv="6" ctrlrange="-2 1" forcerange="-60 20"/>
    <velocity joint="j" kv="1" ctrlrange="-3 3" forcerange="-4 4"/>
  </actuator>
</mujoco>
"""
"""At the joint: -1 to 0.5 rad, 2 · 60 + 4 N m, 3 rad/s, 2² · 80 N m/rad, 2² · 6 + 1 N m s/rad."""


@pytest.fixture
def setup(tmp_path: Path) -> Setup:
    file = tmp_path / "arm.xml"
    file.write_text(ARM)
    return load_setup(str(file))


def answers(setup: Setup, protocol: str, *asked: CanFrame) -> list[bytes]:
    """What the drive answers to each frame."""
    sent: list[CanFrame] = []
    can = CanConfiguration(protocol=protocol, node_ids=(1,))
    plant = setup.scenario.plant
    bank = build_bank(can, setup.robot, plant, sent.append, polled=True, tuned=setup.tuned_drive)
    bank.advance(0)
    found = []
    for frame in asked:
        sent.clear()
        bank.receive(frame, 0)
        found += [each.data for each in sent]
    return found


def test_position_torque_and_gains_are_those_of_a_cia402_drive(setup: Setup) -> None:
    places = [(0x607D, 1), (0x607D, 2), (0x6072, 0), (0x6076, 0), (0x60FB, 1), (0x60F9, 1)]
    uploads = [CanFrame(0x601, struct.pack("<BHBI", 0x40, *each, 0)) for each in places]
    found = [struct.unpack_from("<i", each, 4)[0] for each in answers(setup, "cia402", *uploads)]
    lower, upper, limit, rated_mnm, position_gain, velocity_gain = found
    turn = 2.0 * 3.141592653589793 / (1 << 20)
    assert (lower * turn, upper * turn) == pytest.approx((-1.0, 0.5), abs=turn)
    assert 1e-6 * limit * rated_mnm == pytest.approx(124.0)
    assert (position_gain, velocity_gain) == (12_800, 25_000)  # 320/25 1/s, 25 N m s/rad


def test_speed_is_that_of_a_damiao_motor(setup: Setup) -> None:
    asked = RegisterFrame(1, Request.READ, DamiaoRegister.MAX_SPD)
    (answer,) = answers(setup, "damiao", CanFrame(0x7FF, asked.packed()))
    assert register_frame(answer).value == 3.0


def test_speed_is_that_of_an_odrive_axis(setup: Setup) -> None:
    """However far the target is, its loop asks for 3 rad/s: 25 · 3 N m."""
    steps = ((0x0B, struct.pack("<II", 3, 1)), (0x07, struct.pack("<I", 8)),
             (0x0C, struct.pack("<fhh", 100.0, 0, 0)))  # fmt: skip
    torques = CanFrame(1 << 5 | 0x1C, is_remote=True)
    frames = [CanFrame(1 << 5 | command, data) for command, data in steps]
    target_nm, _ = struct.unpack("<ff", answers(setup, "cansimple", *frames, torques)[-1])
    assert target_nm == pytest.approx(75.0, rel=1e-3)
