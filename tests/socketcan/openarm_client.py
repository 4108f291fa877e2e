"""A program with `openarm_can`: connects to an OpenArm, configures, reads, commands, disconnects.

    python openarm_client.py INTERFACE fd|classical PATIENCE_S

It asks again until it has what it asks for, or loses patience, and prints what it saw as JSON.
"""

import json
import sys
import time

import openarm_can as oa

KINDS = [oa.MotorType.DM8009] * 2 + [oa.MotorType.DM4340] * 2 + [oa.MotorType.DM4310] * 3
STIFFNESS = [240.0] * 4 + [24.0, 31.0, 25.0]
DAMPING = [5.0, 5.0, 3.0, 5.0, 0.3, 0.3, 0.3]
MOVE_RAD, NEAR_RAD = 0.2, 0.05
ROOM_C = 25

interface, frames, patience_s = sys.argv[1:]
arm = oa.OpenArm(interface, frames == "fd")
arm.init_arm_motors(KINDS, list(range(1, 8)), list(range(0x11, 0x18)))


def motors():
    return arm.get_arm().get_motors()


def until(ask, condition):
    """Ask until something is so; whether it came."""
    give_up_s = time.monotonic() + float(patience_s)
    while time.monotonic() < give_up_s:
        ask()
        arm.recv_all(2000)
        if condition():
            return True
    return False


def read(register):
    """Values of a register; None if some motor gives none."""
    arm.set_callback_mode_all(oa.CallbackMode.PARAM)
    is_there = until(
        lambda: arm.query_param_all(register),
        lambda: all(each.get_param(register) >= 1.0 for each in motors()),
    )
    return [each.get_param(register) for each in motors()] if is_there else None


def positions():
    """Positions in real states: it takes late answers about registers for states, too."""
    arm.set_callback_mode_all(oa.CallbackMode.STATE)
    until(
        arm.refresh_all,
        lambda: all(
            (each.get_state_tmos(), each.get_state_trotor()) == (ROOM_C, ROOM_C)
            for each in motors()
        ),
    )
    return [each.get_position() for each in motors()]


def move(targets):
    """Go to some positions; where the motors are then."""
    rows = zip(STIFFNESS, DAMPING, targets, strict=True)
    commands = [oa.MITParam(stiffness, damping, to, 0.0, 0.0) for stiffness, damping, to in rows]
    until(
        lambda: arm.get_arm().mit_control_all(commands),
        lambda: all(
            abs(each.get_position() - to) < NEAR_RAD
            for each, to in zip(motors(), targets, strict=True)
        ),
    )
    return [each.get_position() for each in motors()]


found = {"CTRL_MODE": read(10)}
if found["CTRL_MODE"] is not None:
    found["TMAX"] = read(23)
    found["start"] = positions()
    arm.enable_all()
    arm.recv_all()
    found["end"] = move([position + MOVE_RAD for position in found["start"]])
arm.disable_all()
arm.recv_all()
print(json.dumps(found))
