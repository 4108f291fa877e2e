"""The MIT protocol: a drive alone, and a client that packs frames by the public description."""

import can
import numpy as np
import pytest
from dialects import AK80_9, DISABLE, ENABLE, command, to_float, unpacked
from drive_bench import NODE, Bench

from bus_schema.can.mit.protocol import MitSettings
from plant_emulator.drives.drive import AT_REST, DriveFault, DriveSettings
from plant_emulator.drives.mit.drive import MitDrive
from tests.plant_emulator.drives.test_clients import (
    JOINT,
    NODE_ID,
    PATIENCE_S,
    PUSH_NM,
    START,
    Rig,
    assert_energy_agrees,
)
from tests.waiting import await_true

P_MAX, V_MAX, _, _, T_MAX = AK80_9


def bench_of(**own):
    return Bench(MitDrive, DriveSettings(NODE, 15.0, MitSettings(**own)))


def test_every_frame_is_answered_with_the_state_in_steps_of_the_protocol():
    bench = bench_of()
    bench.move(1.2345, -3.21, 4.5)
    for data in (ENABLE, command(), DISABLE, command()):
        reply = bench.answer(data)
        assert reply.identifier == 0
        node, *state = unpacked(reply.data)
        assert node == NODE
        steps = np.array([2 * P_MAX / 0xFFFF, 2 * V_MAX / 0xFFF, 2 * T_MAX / 0xFFF])
        off = np.array([1.2345, -3.21, 4.5]) - state
        assert (off > -1e-5).all()  # cut off, not rounded; an encoder's step beside that
        assert (off < steps + 1e-5).all()
        assert list(reply.data[6:]) == [25 + 40, 0]


def test_older_firmware_replies_with_six_bytes_to_the_masters_identifier():
    bench = bench_of(reply_bytes=6, reply_identifier=0x50)
    reply = bench.answer(ENABLE)
    assert (reply.identifier, len(reply.data)) == (0x50, 6)


def test_a_command_that_differs_from_a_special_frame_in_one_byte_is_a_command():
    bench = bench_of()
    bench.answer(bytes([*ENABLE[:6], 0xFE, ENABLE[7]]))
    bench.answer(command(t=3.0))
    assert bench.drive.demand() == AT_REST


def test_torque_is_that_of_the_loop_where_the_joint_is():
    bench = bench_of()
    bench.move(0.5, 0.2)
    bench.answer(ENABLE)
    assert bench.drive.demand() == AT_REST  # nothing was commanded yet
    bench.answer(command(p=0.51, v=0.3, kp=100.0, kd=2.0, t=3.0))
    wanted = 100.0 * 0.01 + 2.0 * 0.1 + 3.0
    assert bench.drive.demand().torque_nm == pytest.approx(wanted, abs=0.1)
    loop = bench.drive.demand().loop
    assert loop.torque_nm(0.52, 0.2) == pytest.approx(wanted - 2.0, abs=0.1)
    assert loop.torque_nm(-0.5, 0.2) == 15.0  # the motor's limit
    bench.answer(command(t=3.0))
    assert bench.drive.demand().loop is None
    assert bench.drive.demand().torque_nm == pytest.approx(3.0, abs=0.01)


@pytest.mark.parametrize(
    ("fault", "temperature_c", "error"),
    [(DriveFault.OVER_TEMPERATURE, 110, 1), (DriveFault.ENCODER, 25, 5), (DriveFault.DRIVE, 25, 2)],
)
def test_replies_report_temperature_and_error(fault, temperature_c, error):
    bench = bench_of()
    bench.drive.inject(fault, 0)
    assert list(bench.answer(ENABLE).data[6:]) == [temperature_c + 40, error]


ARM = (4.0, 8.0, 2000.0, 200.0, 400.0)
ARM_OPTIONS = dict(
    zip(
        ("position_rad", "velocity_rad_s", "stiffness_nm_rad", "damping_nm_s", "torque_nm"),
        ARM, strict=True,
    )
)  # fmt: skip


def test_foreign_client_pushes_a_joint():
    """Over python-can, as examples for AK motors do it: send a frame, read the reply."""
    push = command(t=PUSH_NM, ranges=ARM)
    pushed_nm = to_float((push[6] & 0xF) << 8 | push[7], -ARM[4], ARM[4], 12)
    with (
        Rig("mit", mit=ARM_OPTIONS) as rig,
        can.Bus(interface="virtual", channel=rig.channel) as bus,
    ):

        def exchange(data):
            bus.send(can.Message(arbitration_id=NODE_ID, data=data, is_extended_id=False))
            message = bus.recv(PATIENCE_S)
            node_id, position, velocity, _ = unpacked(message.data, ARM)
            assert (message.arbitration_id, node_id) == (0, NODE_ID)
            return position, velocity

        assert exchange(ENABLE)[0] == pytest.approx(START[JOINT], abs=2e-4)
        moved = [0.0, 0.0]

        def has_moved():
            moved[:] = exchange(push)
            return abs(moved[0] - START[JOINT]) > 0.3

        await_true(has_moved)
        half = np.array([ARM[0] / 0xFFFF, ARM[1] / 0xFFF])  # replies are cut off
        position, velocity = moved + half
        assert_energy_agrees(pushed_nm, position, velocity)
