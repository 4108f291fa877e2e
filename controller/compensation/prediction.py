"""Prediction of the state in which a command acts, and what a state teaches about the arm.

The default predictor starts from the measured state, and learns the nominal model's error from
every state: a disturbance, and with `model_identification` inertia, payload, friction and lag.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from bus_schema.arrays import Matrix, Vector
from bus_schema.drive_feedback import DriveGains
from bus_schema.runtime.compiled import all_finite, assign, compiled, scratch
from controller.compensation.arm_belief import ArmBelief, NominalArm
from controller.compensation.command_timeline import (
    CAPACITY,
    HELD,
    LONGEST_HORIZON_NS,
    CommandFeedback,
    Commands,
    Flight,
    ahead,
    assumed_in_force,
    explains,
    observe,
    schedule,
)
from controller.compensation.continued_motion import ContinuedMotion, continue_motion
from controller.compensation.model_identification import Identification, take_in
from controller.compensation.motion_predictor import RigidBodyTerms, is_possible, move
from controller.control_law import LOWER, UPPER

_LARGEST_NM = 1e6
"""Largest disturbance of a plausible state: nothing is learned from a larger one."""


class Arm(NamedTuple):
    """All inputs of a prediction, for compiled code.

    Attributes:
        nominal: the nominal arm.
        belief: the current belief about it.
        identification: the filter that updates the belief.
        drive: gains of the drives' own loops.
        commands: all that were sent.
        last: position and velocity as rows, shape (2, joints): of the state answered last, or of a
            predictor's own model at its stamp.
        last_answered: its stamp in ns and the command in force at it, `HELD` for none; shape (2,).
        memory: what else a predictor remembers, zero at first, shape (4, joints).
        terms: of the rigid bodies in the motion computed last.
        continued: the motion that the law acts on.
    """

    nominal: NominalArm
    belief: ArmBelief
    identification: Identification
    drive: DriveGains
    commands: Commands
    last: Matrix
    last_answered: NDArray[np.int64]
    memory: Matrix
    terms: RigidBodyTerms
    continued: ContinuedMotion


@compiled
def learn_disturbance(
    mass: Matrix, velocity: Vector, predicted_velocity: Vector, step_s: float, gain: float,
    disturbance: Vector,
) -> bool:  # fmt: skip
    """Update the disturbance from the prediction error over a step; return whether it is plausible.

    A constant disturbance is followed with 1 − e^(−bandwidth × time), at any length of the steps.

    Args:
        mass: M(q), kg m², shape (joints, joints).
        velocity: measured at the end of the step, rad/s, shape (joints,).
        predicted_velocity: the model's prediction from the state at its start, rad/s.
        step_s: its length.
        gain: 1 − e^(−bandwidth × step).
        disturbance: f, driving, N m, changed in place.
    """
    joints = velocity.size
    for i in range(joints):
        for j in range(joints):
            missed = mass[i, j] * (velocity[j] - predicted_velocity[j]) / step_s
            if not -_LARGEST_NM < missed < _LARGEST_NM:
                return False
    for i in range(joints):
        missed = 0.0
        for j in range(joints):
            missed += mass[i, j] * (velocity[j] - predicted_velocity[j])
        disturbance[i] += gain * missed / step_s
    return True


@compiled
def foresee(
    arm: Arm, bandwidth_rad_s: float, measured: Matrix, error: Vector, bounds: Matrix,
    predicted: Matrix, target: Matrix, stamp_ns: int, sequence: int, delay_ns: int, arrival_ns: int,
) -> float:  # fmt: skip
    """Learn from a state, and predict for its answer into `predicted`; return the horizon."""
    last_ns = arm.last_answered[0]
    knows, flight = acted_since_last(arm, stamp_ns, sequence, delay_ns, arrival_ns)
    if knows:
        gain = 1.0 - math.exp(-bandwidth_rad_s * 1e-9 * (stamp_ns - last_ns))
        _learn(arm, measured, error, bounds, flight, last_ns, stamp_ns, gain)
    assign(arm.last, measured)
    acts_ns = move_ahead(arm, measured, stamp_ns, predicted)
    if bandwidth_rad_s > 0.0:
        in_force = arm.last_answered[1]
        continue_motion(
            arm.continued, arm.terms, arm.nominal, arm.belief, arm.drive, arm.commands,
            in_force, acts_ns, acts_ns - stamp_ns, predicted,
        )  # fmt: skip
    return aim(measured, predicted, target, acts_ns - stamp_ns)


@compiled
def acted_since_last(
    arm: Arm, stamp_ns: int, sequence: int, delay_ns: int, arrival_ns: int
) -> tuple[bool, Flight]:
    """Take in a state's feedback; return whether it tells what acted since the last, and what.

    The state becomes the last one answered, except for `Arm.last`.
    """
    commands, (last_ns, last_in_force) = arm.commands, arm.last_answered
    if explains(commands, sequence, delay_ns, stamp_ns):
        observe(commands, CommandFeedback(sequence, delay_ns, arrival_ns), stamp_ns, last_ns)
        if delay_ns <= commands.announced_ns[sequence % CAPACITY]:
            delay_ns = 0  # it acted at its announced time, and so did those before
    else:
        sequence = assumed_in_force(commands, stamp_ns)
        delay_ns = commands.state[0].horizon_ns
    arm.last_answered[0], arm.last_answered[1] = stamp_ns, sequence
    if HELD < last_in_force <= sequence and stamp_ns - last_ns <= LONGEST_HORIZON_NS:
        return True, schedule(commands, last_in_force, sequence, delay_ns, last_ns)
    return False, Flight(HELD, HELD, HELD, 0)


@compiled
def _learn(
    arm: Arm, measured: Matrix, error: Vector, bounds: Matrix, flight: Flight,
    last_ns: int, stamp_ns: int, gain: float,
) -> None:  # fmt: skip
    """Compare the arm's motion since the last state with the prediction."""
    nominal, belief, identification, drive, commands, last, _, _, terms, _ = arm
    joints, step_s = error.size, (stamp_ns - last_ns) * 1e-9
    motion, impulse = scratch((3, joints)), scratch(joints)
    actuator, actuator_before = scratch(joints), scratch(joints)
    assign(actuator, belief.actuator_nm)
    assign(actuator_before, actuator)
    assign(motion[:2], last)
    move(
        nominal, belief, drive, commands, flight, last_ns, stamp_ns, terms,
        motion, actuator, impulse,
    )  # fmt: skip
    if not all_finite(actuator):
        return
    assign(belief.actuator_nm, actuator)
    known = belief.disturbance_nm
    if not learn_disturbance(terms.mass, measured[1], motion[1], step_s, gain, known):
        return
    if identification.is_active and _is_inside(error, bounds):
        take_in(nominal, identification, belief, last, measured, actuator_before, impulse, step_s)
    else:
        identification.window.elapsed_s[0] = 0.0


@compiled
def _is_inside(error: Vector, bounds: Matrix) -> bool:
    """Whether all errors are inside the funnel: a lost arm's motion teaches nothing useful."""
    for i in range(error.size):  # noqa: SIM110 (numba compiles no generators)
        if not -bounds[LOWER, i] < error[i] < bounds[UPPER, i]:
            return False
    return True


@compiled
def move_ahead(arm: Arm, state: Matrix, stamp_ns: int, moved: Matrix) -> int:
    """Move a state by the model until the answer to the newest one acts; return when that is.

    Args:
        arm: the arm, which was given the newest state.
        state: position, rad, and velocity, rad/s, as rows, shape (2, joints).
        stamp_ns: stamp of the newest state.
        moved: the same afterwards.
    """
    nominal, belief, _, drive, commands, _, last_answered, _, terms, _ = arm
    joints = state.shape[1]
    motion, impulse, actuator = scratch((3, joints)), scratch(joints), scratch(joints)
    assign(actuator, belief.actuator_nm)
    assign(motion[:2], state)
    flight = ahead(commands, last_answered[1], stamp_ns)
    acts_ns = stamp_ns + commands.state[0].horizon_ns + int(1e9 * belief.lag_s[0])
    move(
        nominal, belief, drive, commands, flight, stamp_ns, acts_ns, terms,
        motion, actuator, impulse,
    )  # fmt: skip
    assign(moved, motion[:2])
    return acts_ns  # type: ignore[no-any-return]


@compiled
def aim(measured: Matrix, predicted: Matrix, target: Matrix, horizon_ns: int) -> float:
    """Write the drives' target for a prediction, and return its horizon in s."""
    horizon_s = horizon_ns * 1e-9
    if not is_possible(predicted):  # the model has diverged, and a law would compute with that
        assign(predicted, measured)
    for i in range(measured.shape[1]):
        target[1, i] = predicted[1, i]
        target[0, i] = predicted[0, i] - horizon_s * predicted[1, i]
    return horizon_s
