"""Rows of a command for the time after it acts, which bridge lost commands.

The arm is expected to return to the reference from its predicted error e, critically damped. The
torque of the believed arm along this motion, τ̂(t), changes that of the law: τ(t) = τ + τ̂(t) − τ̂(0).
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from bus_schema.arrays import Matrix, Vector
from bus_schema.runtime.compiled import all_finite, bind, compiled, scratch
from controller.compensation.arm_belief import ArmBelief, NominalArm, smooth_sign
from controller.compensation.command_timeline import Commands, add_change
from controller.control_law import Tracking
from controller.reference import Reference
from controller.rigid_bodies.dynamics import inverse_dynamics

_RETURNS_RAD_S = 15.0
"""ω of the return: e(t) = (e + (ė + ω e) t) exp(−ω t)."""


def filling(
    nominal: NominalArm, belief: ArmBelief, commands: Commands, predicted: Tracking,
    reference: Reference, torques_nm: Matrix, targets: NDArray[np.float64],
) -> Callable[[], None]:  # fmt: skip
    """Return a function that fills the rows of a command after its first.

    Args:
        nominal: the nominal arm.
        belief: the belief about it.
        commands: those sent; the plan of the next one is written into them.
        predicted: situation in which the command acts, on `reference`.
        reference: the reference.
        torques_nm: shape (rows, joints); the first row is that of the law.
        targets: for the drives: positions, rad, and velocities, rad/s, shape (2, rows, joints).
    """
    state = commands.state[0]
    piece_s = 1e-9 * float(state["tick_ns"]) * int(state["row_ticks"])
    follow = [reference.onto(*end) for end in commands.next_plan]
    compute = bind(
        _fill, nominal, belief, commands, predicted.error, predicted.error_rate, piece_s,
        torques_nm, targets, free=["float64"],
    )  # fmt: skip

    def fill() -> None:
        for end, follow_until in enumerate(follow):
            follow_until(predicted.time_s + end * piece_s)
        compute(predicted.horizon_s)

    return fill


@compiled
def _fill(
    nominal: NominalArm, belief: ArmBelief, commands: Commands, error: Vector, error_rate: Vector,
    piece_s: float, torques_nm: Matrix, targets: NDArray[np.float64], horizon_s: float,
) -> None:  # fmt: skip
    """Turn the reference at the ends of the pieces into the plan, and fill the rows by it."""
    plan, limits_nm, joints = commands.next_plan, nominal.limits_nm, error.size
    torque, values, omega = scratch(joints), scratch((3, joints)), _RETURNS_RAD_S
    for end in range(len(plan)):
        after_s = end * piece_s
        left = math.exp(-omega * after_s)
        for i in range(joints):
            rate = error_rate[i] + omega * error[i]
            away = error[i] + rate * after_s
            plan[end, 0, i] += left * away
            plan[end, 1, i] += left * (rate - omega * away)
            plan[end, 2, i] += left * omega * (omega * away - 2.0 * rate)
        motion = plan[end]
        inverse_dynamics(nominal.bodies, belief.inertia, motion[0], motion[1], motion[2], torque)
        for i in range(joints):
            position, velocity = plan[end, 0, i], plan[end, 1, i]
            friction = belief.coulomb_nm[i] * smooth_sign(velocity)[0]
            plan[end, 0, i] = torque[i] + friction + belief.viscous_nm_s[i] * velocity
            plan[end, 1, i], plan[end, 2, i] = position - horizon_s * velocity, velocity
    if not all_finite(plan):
        plan[:] = 0.0  # numbers overflowed: all rows repeat the first
    for row in range(1, len(plan)):
        values[0], values[1], values[2] = torques_nm[0], targets[0, 0], targets[1, 0]
        add_change(plan, row - 1, 1.0, values)
        for i in range(joints):
            torques_nm[row, i] = min(max(values[0, i], -limits_nm[i]), limits_nm[i])
        targets[0, row], targets[1, row] = values[1], values[2]
