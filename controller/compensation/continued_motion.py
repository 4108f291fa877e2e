"""The motion that a law acts on: its own last prediction, continued.

A law that answers each new prediction by itself closes its fast loop around the delay: a model
error of a share δ changes every prediction, the law answers with its full gain, and the answer
returns one horizon later. So the last prediction is continued by what the law itself has asked
for since, which is exact at any gain, and it returns to the newest prediction through a first-order
filter of `RETURNS` per horizon. What passes around the delay is then only the correction, with a
loop gain of about δ at frequencies up to `RETURNS` / horizon, for any gain of the law.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from bus_schema.arrays import Matrix, Vector
from bus_schema.drive_feedback import DriveGains
from bus_schema.runtime.compiled import assign, compiled, scratch
from controller.compensation.arm_belief import ArmBelief, NominalArm
from controller.compensation.command_timeline import HELD, Commands, Flight
from controller.compensation.motion_predictor import RigidBodyTerms, is_possible, stretch

RETURNS = 15.0
"""How often per horizon the motion returns to the newest prediction.

With 5 an arm whose model is wrong is corrected too late, with 40 some leave their bounds at 96 ms
as they do without a filter; between 10 and 20 margins differ by hundredths of a bound.
"""
_RETURNS_LATE = 4.0
"""The same while commands come late: a prediction then has them act too early."""


class ContinuedMotion(NamedTuple):
    """The motion that the law acted on last, and where it ended.

    Attributes:
        motion: position and velocity as rows, shape (2, joints).
        actuator_nm: torque that the actuators deliver then, N m, shape (joints,).
        until_ns: its time, shape (1,).
    """

    motion: Matrix
    actuator_nm: Vector
    until_ns: NDArray[np.int64]


def no_motion(joints: int) -> ContinuedMotion:
    """Return a motion before the first prediction."""
    return ContinuedMotion(np.zeros((2, joints)), np.zeros(joints), np.zeros(1, np.int64))


@compiled
def forget_motion(continued: ContinuedMotion) -> None:
    """Begin again with the next prediction."""
    continued.motion[:] = 0.0
    continued.actuator_nm[:] = 0.0
    continued.until_ns[0] = 0


@compiled
def continue_motion(
    continued: ContinuedMotion, terms: RigidBodyTerms, nominal: NominalArm, belief: ArmBelief,
    drive: DriveGains, commands: Commands, in_force: int, acts_ns: int, horizon_ns: int,
    predicted: Matrix,
) -> None:  # fmt: skip
    """Move the last motion on by the newest command, and return it towards a prediction.

    Args:
        continued: the last motion, changed in place.
        terms: of the rigid bodies at the prediction.
        nominal: the arm's structure and limits.
        belief: its friction, lag and disturbance.
        drive: gains of the drives' own loops.
        commands: all that were sent; the newest one acts from the end of the last motion on.
        in_force: the command in force at the newest state; where it is `HELD`, the arm stands, and
            the prediction needs no correction.
        acts_ns: time of the prediction.
        horizon_ns: time from the newest state until then.
        predicted: the prediction from that state, replaced by the motion, shape (2, joints).
    """
    newest, joints = commands.state[0].newest, predicted.shape[1]
    from_ns = continued.until_ns[0]
    if in_force > HELD and 0 < acts_ns - from_ns <= horizon_ns:
        motion, impulse = scratch((3, joints)), scratch(joints)
        assign(motion[:2], continued.motion)
        stretch(
            terms, nominal.limits_nm, belief, drive, commands,
            Flight(newest, newest + 1, newest, 0),
            from_ns, acts_ns, motion, continued.actuator_nm, impulse,
        )  # fmt: skip
        returns = RETURNS if commands.state[0].late_since_ns < 0 else _RETURNS_LATE
        left = math.exp(-returns * (acts_ns - from_ns) / horizon_ns)
        if is_possible(motion):
            for k in range(2):
                for i in range(joints):
                    predicted[k, i] += left * (motion[k, i] - predicted[k, i])
    else:
        assign(continued.actuator_nm, belief.actuator_nm)
    assign(continued.motion, predicted)
    continued.until_ns[0] = acts_ns if in_force > HELD else 0
