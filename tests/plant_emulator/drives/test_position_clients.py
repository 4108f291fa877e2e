"""Clients of others move joints by position, on python-can's virtual bus.

Their joints come to stand at targets, which is true on the slowest machine; what they pass on their
way there is in test_position_modes.py.
"""

import asyncio
import math
import time

import can
import cantools
from odrive_can.odrive import ODriveCAN
from odrive_can.utils import get_dbc_path

from bus_schema.link.can_configuration import CANSIMPLE_DBC
from deploy.scenario.scenario import load_setup
from tests.plant_emulator.drives.test_clients import PATIENCE_S, START, Rig, canopen_client
from tests.waiting import await_true

TUNED = load_setup("paper_arm", []).tuned_drive
MOVED_RAD = 0.2
NEAR_RAD = 5e-3
TURN = 2 * math.pi


def test_canopens_own_client_moves_a_joint_in_cyclic_synchronous_position():
    """As its documentation has it; RPDO 3 has target and torque offset in place of RPDO 1."""
    mode = "CYCLIC SYNCHRONOUS POSITION"
    with Rig("cia402", TUNED) as rig, canopen_client(rig, 1, mode, pdo=3) as node:
        follow_targets(node)


def follow_targets(node):
    per_rad = node.sdo[0x608F][1].raw / TURN
    start, end = (round(each * per_rad) for each in (START[0], START[0] + MOVED_RAD))
    node.rpdo[3]["Target position"].raw = start
    for state in ("READY TO SWITCH ON", "SWITCHED ON", "OPERATION ENABLED"):
        node.state = state
    for step in range(1, 51):
        node.rpdo[3]["Target position"].raw = start + (end - start) * step // 50
        node.rpdo[3].transmit()
        time.sleep(0.005)
    await_true(lambda: abs(node.sdo[0x6064].raw - end) < NEAR_RAD * per_rad)
    assert node.state == "OPERATION ENABLED"
    node.state = "SWITCH ON DISABLED"


async def until_it_works(action):
    """Its answers are awaited for a second, which a busy machine may take."""
    give_up_s = time.monotonic() + PATIENCE_S
    while True:
        try:
            return await action()
        except TimeoutError:
            assert time.monotonic() < give_up_s, "it never came"


async def move_with_odrive_can(channel, target):
    drive = ODriveCAN(2, can.Bus(interface="virtual", channel=channel))
    await asyncio.wait_for(drive.start(), PATIENCE_S)
    drive.clear_errors()
    drive.set_limits(5.0, 690.0)
    drive.set_controller_mode("POSITION_CONTROL", "PASSTHROUGH")
    await until_it_works(lambda: drive.set_axis_state("CLOSED_LOOP_CONTROL"))
    drive.check_errors()
    drive.set_input_pos(target, vel_ff=0.0, torque_ff=1.0)
    estimate = math.inf
    give_up_s = time.monotonic() + PATIENCE_S
    while abs(estimate - target) > NEAR_RAD / TURN:
        assert time.monotonic() < give_up_s, "it never came"
        estimate = (await until_it_works(drive.get_encoder_estimates))["Pos_Estimate"]
    state = drive.axis_state
    drive.stop()
    return state


def test_odrive_can_moves_a_joint():
    with Rig("cansimple", TUNED) as rig:
        target = (START[1] + MOVED_RAD) / TURN
        assert asyncio.run(move_with_odrive_can(rig.channel, target)) == "CLOSED_LOOP_CONTROL"
    assert not any("WATCHDOG" in event for event in rig.events)


def layout(signal):
    is_signed = signal.is_signed and not signal.is_float  # which a DBC may say of floats or not
    return signal.start, signal.length, signal.scale, signal.is_float, is_signed


def test_our_dbc_says_what_odrives_own_of_0_6_10_says():
    """All 28 messages, as odrive-can ships them: identifiers, names, places, scales and words."""
    ours = cantools.database.load_file(CANSIMPLE_DBC)
    theirs = cantools.database.load_file(get_dbc_path())
    wanted = [each for each in theirs.messages if each.name.startswith("Axis0_")]
    assert len(ours.messages) == len(wanted) == 28
    for message in wanted:
        own = ours.get_message_by_frame_id(message.frame_id)
        assert f"Axis0_{own.name}" == message.name
        for signal in message.signals:
            mine = own.get_signal_by_name(signal.name)
            assert layout(mine) == layout(signal)
            assert words(signal).items() <= words(mine).items()


def words(signal):
    return {number: str(word).upper() for number, word in (signal.choices or {}).items()}
