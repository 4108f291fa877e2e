"""mjbots' own client, unmodified, moves emulated moteus controllers; and what it sees of faults."""

from __future__ import annotations

import asyncio
import importlib
import math

import pytest

from plant_emulator.drives.drive import DriveFault
from tests.plant_emulator.drives.damiao_clients import fetch_wheel
from tests.plant_emulator.drives.test_clients import JOINT, PATIENCE_S, START, Rig, until

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
        why_not = fetch_wheel(name, version, request.config.cache.mkdir("wheels"))
        if why_not is not None:
            pytest.skip(why_not)
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
        until(lambda: rig.bank.braked.all())


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


def test_a_motor_that_is_not_there_shows_as_a_client_that_waits(moteus):
    async def conversation(controller, _):
        return await controller.query()

    with Rig("moteus", **FD) as rig, pytest.raises(asyncio.TimeoutError):
        talk(moteus, rig, conversation, node_id=99, patience_s=0.5)
