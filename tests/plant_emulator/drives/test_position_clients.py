"""Clients of others move joints by position, on python-can's virtual bus.

Their joints come to stand at targets, which is true on the slowest machine; what they pass on their
way there is in test_position_modes.py.
"""

import asyncio
import math
import time

import can
import canopen
import cantools
from odrive_can.odrive import ODriveCAN
from odrive_can.utils import get_dbc_path

from bus_schema.link.can_configuration import CANSIMPLE_DBC
from deploy.scenario.scenario import load_setup
from tests.plant_emulator.drives.test_clients import PATIENCE_S, START, Rig, patient_node, until

TUNED = load_setup("paper_arm", []).tuned_drive
MOVED_RAD = 0.2
NEAR_RAD = 5e-3
TURN = 2 * math.pi


def test_canopens_own_client_moves_a_joint_in_cyclic_synchronous_position():
    """As its documentation has it; RPDO 3 has target and torque offset in place of RPDO 1."""
    with Rig("cia402", TUNED) as rig:
        network = canopen.Network()
        network.connect(interface="virtual", channel=rig.channel)
        try:
            node = patient_node(1)
            network.add_node(node)
            node.nmt.wait_for_heartbeat(PATIENCE_S)
            node.rpdo.read()
            node.rpdo[1].enabled = False
            node.rpdo[3].enabled = True
            node.rpdo.save()
            node.setup_402_state_machine()
            node.nmt.state = "OPERATIONAL"
            network.sync.start(0.01)
            node.op_mode = "CYCLIC SYNCHRONOUS POSITION"
            until(lambda: node.op_mode == "CYCLIC SYNCHRONOUS POSITION")
            follow_targets(node)
        finally:
            network.sync.stop()
            network.disconnect()


def follow_targets(node):
    per_rad = node.sdo[0x608F][1].raw / TURN
    start, end = (round(each * per_rad) for each in (START[0], START[0] + MOVED_RAD))
    node.rpdo[3]["Target position"].raw = start
    for state in ("READY TO SWITCH ON", "SWITCHED ON", "OPERATION ENABLED"):
        node.state = state
    node.sdo[0x6065].raw = round(0.05 * per_rad)
    node.sdo[0x6072].raw = 0  # no torque, so a target that is off stays off
    node.rpdo[3]["Target position"].raw = end
    node.rpdo[3].transmit()
    until(lambda: node.statusword & 1 << 13)
    node.rpdo[3]["Target position"].raw = start
    node.rpdo[3].transmit()
    until(lambda: not node.statusword & 1 << 13)
    node.sdo[0x6072].raw = 20_000
    node.sdo[0x6065].raw = 0xFFFF_FFFF
    for step in range(1, 51):
        node.rpdo[3]["Target position"].raw = start + (end - start) * step // 50
        node.rpdo[3].transmit()
        time.sleep(0.005)
    until(lambda: abs(node.sdo[0x6064].raw - end) < NEAR_RAD * per_rad)
    assert node.state == "OPERATION ENABLED"
    node.state = "SWITCH ON DISABLED"


def test_cantools_with_our_dbc_moves_a_joint():
    database = cantools.database.load_file(CANSIMPLE_DBC)
    target = (START[2] + MOVED_RAD) / TURN
    with Rig("cansimple", TUNED) as rig:
        bus = can.Bus(interface="virtual", channel=rig.channel)

        def say(name, **signals):
            message = database.get_message_by_name(name)
            identifier = 3 << 5 | message.frame_id
            data = message.encode(signals)
            bus.send(can.Message(arbitration_id=identifier, data=data, is_extended_id=False))

        def has_arrived():
            message = bus.recv(0.05)
            if message is None or message.arbitration_id != 3 << 5 | 0x09:
                return False
            estimate = database.decode_message(0x09, message.data)["Pos_Estimate"]
            return abs(estimate - target) < NEAR_RAD / TURN

        try:
            say("Set_Controller_Mode", Control_Mode="POSITION_CONTROL", Input_Mode="PASSTHROUGH")
            say("Set_Limits", Velocity_Limit=5.0, Current_Limit=300.0)
            say("Set_Axis_State", Axis_Requested_State="CLOSED_LOOP_CONTROL")
            say("Set_Input_Pos", Input_Pos=target, Vel_FF=0.0, Torque_FF=0.5)
            until(has_arrived)
        finally:
            bus.shutdown()


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
