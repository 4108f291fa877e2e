"""Prediction of the arm's motion from the belief and the torques in flight.

The rigid-body terms M and C q̇ + G change slowly: they are computed every few milliseconds, for the
middle of the interval. Friction is stiff: it is integrated in steps of at most a millisecond,
implicitly in the velocity. The drives' own loops are soft in comparison.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from bus_schema.arrays import Matrix, Vector
from bus_schema.drive_feedback import DriveGains, drive_torque
from bus_schema.runtime.compiled import assign, compiled, scratch
from controller.compensation.arm_belief import ArmBelief, NominalArm, smooth_sign
from controller.compensation.command_timeline import (
    CAPACITY,
    HELD,
    Commands,
    Flight,
    acts_ns,
    command_at,
)  # fmt: skip
from controller.rigid_bodies.dynamics import mass_and_load
from controller.rigid_bodies.vectors import invert

_STRETCH_NS = 16_000_000
_STEP_NS = 1_000_000
_LARGEST_MOTION = 1e4
"""Position and velocity that no arm reaches, rad and rad/s, or m and m/s."""


class RigidBodyTerms(NamedTuple):
    """Rigid-body terms of the motion computed last, kept for what continues it.

    Attributes:
        mass: M, kg m², shape (joints, joints).
        inverse: M⁻¹, shape (joints, joints).
        load: C q̇ + G, N m, shape (joints,).
    """

    mass: Matrix
    inverse: Matrix
    load: Vector


def no_terms(joints: int) -> RigidBodyTerms:
    """Return terms before any motion is computed."""
    return RigidBodyTerms(np.zeros((joints, joints)), np.zeros((joints, joints)), np.zeros(joints))


@compiled
def move(
    nominal: NominalArm, belief: ArmBelief, drive: DriveGains, commands: Commands, flight: Flight,
    from_ns: int, until_ns: int, terms: RigidBodyTerms, motion: Matrix, actuator: Vector,
    impulse: Vector,
) -> None:  # fmt: skip
    """Move an arm from one instant to another; until a first command acts, it stands still.

    Args:
        nominal: the arm's structure and limits.
        belief: its inertia, friction, lag and disturbance.
        drive: gains of the drives' own loops.
        commands: all that were sent.
        flight: which of them act from `from_ns` on, and when.
        from_ns: start.
        until_ns: end.
        terms: the rigid-body terms, overwritten.
        motion: position, velocity and, in the end, mean acceleration as rows, shape (3, joints).
        actuator: torque that the actuators deliver, N m, shape (joints,).
        impulse: time integral of what they are asked for, N m s, shape (joints,).
    """
    joints = actuator.size
    mass, inverse, load = terms
    middle = scratch((2, joints))
    motion[2] = 0.0
    impulse[:] = 0.0
    in_force, upcoming, newest, delay_ns = flight
    now_ns = from_ns
    if in_force == HELD:
        now_ns = until_ns
        if upcoming <= newest:
            now_ns = max(from_ns, acts_ns(commands, upcoming % CAPACITY, delay_ns))
    while now_ns < until_ns:
        end_ns = now_ns + _STRETCH_NS
        if end_ns > until_ns - _STEP_NS:  # the rest is too short for separate terms
            end_ns = until_ns
        half_s = 0.5e-9 * (end_ns - now_ns)
        for i in range(joints):
            middle[1, i] = motion[1, i] + half_s * motion[2, i]
            middle[0, i] = motion[0, i] + half_s * middle[1, i]
        mass_and_load(nominal.bodies, belief.inertia, middle[0], middle[1], mass, load)
        invert(mass, inverse)
        in_force, upcoming = stretch(
            terms, nominal.limits_nm, belief, drive, commands,
            Flight(in_force, upcoming, newest, delay_ns), now_ns, end_ns,
            motion, actuator, impulse,
        )  # fmt: skip
        now_ns = end_ns


@compiled
def stretch(
    terms: RigidBodyTerms, limits: Vector, belief: ArmBelief, drive: DriveGains,
    commands: Commands, flight: Flight, from_ns: int, until_ns: int,
    motion: Matrix, actuator: Vector, impulse: Vector,
) -> tuple[int, int]:  # fmt: skip
    """Move with constant rigid-body terms; return the command in force at the end, and the next."""
    position, velocity, acceleration = motion[0], motion[1], motion[2]
    in_force, upcoming, newest, delay_ns = flight
    _, inverse_mass, load = terms
    joints, lag_s = position.size, belief.lag_s[0]
    asked, total, slope = scratch(joints), scratch(joints), scratch(joints)
    row = scratch((3, joints))
    assign(acceleration, velocity)  # start velocity, replaced at the end
    now_ns, last_step_ns, left, mean_left = from_ns, 0, 0.0, 0.0
    while now_ns < until_ns:
        end_ns = min(now_ns + _STEP_NS, until_ns)
        while upcoming <= newest:
            following_ns = acts_ns(commands, upcoming % CAPACITY, delay_ns)
            if following_ns > now_ns:
                end_ns = min(end_ns, following_ns)
                break
            in_force, upcoming = upcoming, upcoming + 1
        slot, step_s = in_force % CAPACITY, (end_ns - now_ns) * 1e-9
        if end_ns - now_ns != last_step_ns:
            last_step_ns = end_ns - now_ns
            left = math.exp(-step_s / lag_s) if lag_s > 0.0 else 0.0
            mean_left = (1.0 - left) * lag_s / step_s
        age_s = command_at(commands, slot, now_ns, row)
        _ask(row, age_s, drive, limits, position, velocity, asked)
        for i in range(joints):
            impulse[i] += step_s * asked[i]
            behind = actuator[i] - asked[i]
            actuator[i] = asked[i] + left * behind
            sign, slope[i] = smooth_sign(velocity[i])
            friction = belief.coulomb_nm[i] * sign + belief.viscous_nm_s[i] * velocity[i]
            delivered = asked[i] + mean_left * behind
            total[i] = delivered + belief.disturbance_nm[i] - friction - load[i]
        _push(inverse_mass, total, belief, slope, step_s, position, velocity)
        now_ns = end_ns
    for i in range(joints):
        acceleration[i] = (velocity[i] - acceleration[i]) / ((until_ns - from_ns) * 1e-9)
    return in_force, upcoming


@compiled
def _ask(
    row: Matrix, age_s: float, drive: DriveGains, limits: Vector, position: Vector,
    velocity: Vector, asked: Vector,
) -> None:  # fmt: skip
    """Write the torque that a row with a target of this age and the drive loops request, N m."""
    for i in range(asked.size):
        asked[i] = row[0, i]
        if drive.is_active:
            asked[i] += drive_torque(
                row[1, i] + age_s * row[2, i], row[2, i], position[i], velocity[i], drive, i
            )
            asked[i] = min(max(asked[i], -limits[i]), limits[i])


@compiled
def _push(
    inverse_mass: Matrix, total: Vector, belief: ArmBelief, slope: Vector, step_s: float,
    position: Vector, velocity: Vector,
) -> None:  # fmt: skip
    """Move by one step under these torques, implicitly in the damping of friction."""
    for i in range(total.size):
        damping = belief.coulomb_nm[i] * slope[i] + belief.viscous_nm_s[i]
        pull = 0.0
        for j in range(total.size):
            pull += inverse_mass[i, j] * total[j]
        change = step_s * pull / (1.0 + step_s * inverse_mass[i, i] * damping)
        position[i] += step_s * (velocity[i] + 0.5 * change)
        velocity[i] += change


@compiled
def is_possible(motion: Matrix) -> bool:
    """Whether no joint is predicted at a place, or a speed, that no arm can have."""
    for value in motion.flat:  # noqa: SIM110 (numba compiles no generators)
        if not abs(value) < _LARGEST_MOTION:  # NaN is not below it either
            return False
    return True
