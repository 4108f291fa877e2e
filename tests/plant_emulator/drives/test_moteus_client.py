"""mjbots' own client, unmodified, moves emulated moteus controllers, and reads their faults."""

from __future__ import annotations

import asyncio
import importlib
import math

import numpy as np
import pytest

from bus_schema.can.frame import CanFrame
from bus_schema.can.moteus.codec import MoteusCodec
from plant_emulator.drives.cascade import UNTUNED
from plant_emulator.drives.drive import DriveFault, DriveSettings, JointReading
from plant_emulator.drives.moteus.drive import MoteusDrive
from tests.plant_emulator.drives.damiao_clients import fetch_wheel
from tests.plant_emulator.drives.test_clients import JOINT, PATIENCE_S, START, Rig
from tests.waiting import await_true

WHEELS = {"moteus": "1.1.1", "pyserial": "3.5", "importlib-metadata": "8.7.0"}
TURN_RAD = 2.0 * math.pi
FD = {"fd": True, "data_bitrate": 5_000_000, "fd_process_data": True}
STOPPED, FAULT, POSITION, TIMEOUT = 0, 1, 10, 11
DRIVER_FAULT = 33  # "motor driver fault" of the firmware's table
NODE = JOINT + 1


@pytest.fixture(scope="module")
def moteus(request):
    """mjbots' package; to be imported it needs pyserial and importlib-metadata."""
    for name, version in WHEELS.items():
        fetch_wheel(name, version, request.config.cache.mkdir("wheels"))
    return importlib.import_module("moteus")


def talk(moteus, rig, conversation, node_id=NODE, patience_s=PATIENCE_S):
    """What a coroutine returns that talks to the drive of a joint with the client."""

    async def connected():
        device = moteus.PythonCanDevice(interface="virtual", channel=rig.channel, fd=True)
        transport = moteus.Transport(device)
        try:
            controller = moteus.Controller(id=node_id, transport=transport)
            return await asyncio.wait_for(conversation(controller, moteus.Register), patience_s)
        finally:
            transport.close()

    return asyncio.run(connected())


def test_it_reads_moves_and_stops(moteus):
    target = START[JOINT] + 0.2

    async def conversation(controller, register):
        await controller.set_stop()
        at_rest = await controller.query()
        while True:
            state = await controller.set_position(
                position=target / TURN_RAD, kp_scale=1.0, kd_scale=1.0, query=True
            )
            if abs(state.values[register.POSITION] * TURN_RAD - target) < 0.02:
                break
        await controller.set_stop()
        return at_rest.values, state.values, (await controller.query()).values

    with Rig("moteus", **FD) as rig:
        register = moteus.Register
        at_rest, moved, stopped = talk(moteus, rig, conversation)
        assert at_rest[register.MODE] == STOPPED
        assert at_rest[register.POSITION] * TURN_RAD == pytest.approx(START[JOINT], abs=2e-3)
        assert moved[register.MODE] == POSITION
        assert (stopped[register.MODE], stopped[register.FAULT]) == (STOPPED, 0)
        await_true(lambda: rig.bank.braked.all())


def test_a_command_that_is_not_repeated_ends_in_a_timeout_until_it_is_stopped(moteus):
    async def conversation(controller, register):
        await controller.set_position(position=math.nan, watchdog_timeout=0.05)
        while (await controller.query()).values[register.MODE] != TIMEOUT:
            pass
        ignored = await controller.set_position(position=math.nan, query=True)
        await controller.set_stop()
        again = await controller.set_position(position=math.nan, query=True)
        return ignored.values[register.MODE], again.values[register.MODE]

    with Rig("moteus", **FD) as rig:
        assert talk(moteus, rig, conversation) == (TIMEOUT, POSITION)


def test_a_fault_of_the_drive_is_raised_by_the_client(moteus):
    async def conversation(controller, register):
        await controller.set_position(position=math.nan, query=True)
        rig.bank.inject(JOINT, DriveFault.DRIVE, 0)
        while (await controller.query()).values[register.MODE] != FAULT:
            pass
        with pytest.raises(moteus.FaultError, match=f"mode={FAULT} code={DRIVER_FAULT}$"):
            await controller.set_position_wait_complete(position=math.nan)

    with Rig("moteus", **FD) as rig:
        talk(moteus, rig, conversation)


def test_client_waits_for_a_missing_motor(moteus):
    async def conversation(controller, _):
        return await controller.query()

    with Rig("moteus", **FD) as rig, pytest.raises(asyncio.TimeoutError):
        talk(moteus, rig, conversation, node_id=99, patience_s=0.5)


def test_commands_of_our_master_are_those_that_the_client_packs(moteus):
    controller = moteus.Controller(id=5)
    torque_nm, timeout_s = 1.5, 0.05
    for gains, target in ((0.0, None), (1.0, (0.25, -0.5))):
        turns, turns_s = (math.nan, math.nan) if target is None else target
        theirs = controller.make_position(
            position=turns, velocity=turns_s, feedforward_torque=torque_nm,
            kp_scale=gains, kd_scale=gains, watchdog_timeout=timeout_s,
        )  # fmt: skip
        codec = MoteusCodec([5], timeout_s, has_gains=target is not None)
        rows = None if target is None else np.array(target)[:, None] * TURN_RAD
        (ours,) = codec.command_frames(np.array([torque_nm]), rows)
        assert ours.data == theirs.data
    assert codec.stop_frames()[0].data == controller.make_stop().data


@pytest.mark.parametrize(
    ("form", "position", "torque_nm"),
    # steps of 0.01, 0.0001 and 0.00001 turns, cut off; what no integer holds is the nearest one
    [("INT8", 1.27, 4.0), ("INT16", 1.4005, 4.12), ("INT32", 1.40056, 4.123)],
)
def test_client_reads_integers_in_the_steps_of_its_registers(moteus, form, position, torque_nm):
    sent = []
    drive = MoteusDrive(DriveSettings(5, 9.0, None), sent.append)
    drive.measure(JointReading(8.8, 0.0, 4.1235))  # 1.400563 turns
    register, resolution = moteus.Register, getattr(moteus, form)
    asked = dict.fromkeys(
        (register.POSITION, register.TORQUE, register.COMMAND_POSITION_MAX_TORQUE), resolution
    )
    command = moteus.Controller(id=5).make_custom_query(asked)
    assert drive.receive(CanFrame(0x8705, command.data, is_extended=True, is_fd=True), 0)
    assert (sent[0].identifier, sent[0].is_extended, sent[0].is_fd) == (0x507, False, True)
    values = command.parse(moteus.transport_device.Frame(0x507, sent[0].data)).values
    assert values[register.POSITION] == pytest.approx(position)
    assert values[register.TORQUE] == pytest.approx(torque_nm)
    assert math.isnan(values[register.COMMAND_POSITION_MAX_TORQUE])  # the lowest integer


def test_target_moves_at_its_velocity_up_to_where_it_is_to_stop(moteus):
    drive = MoteusDrive(DriveSettings(5, 9000.0, None), lambda _: None)
    command = moteus.Controller(id=5).make_position(
        position=0.0, velocity=1.0, stop_position=0.5, kd_scale=0.0
    )
    assert drive.receive(CanFrame(5, command.data, is_fd=True), 0)
    loop = drive.demand().loop
    stiffness = UNTUNED.position_1_s * UNTUNED.velocity_nm_s
    torques = [loop.torque_nm(0.0, 0.0, 0.2) / stiffness / TURN_RAD for _ in range(4)]
    assert torques == pytest.approx([0.2, 0.4, 0.5, 0.5], abs=1e-6)
