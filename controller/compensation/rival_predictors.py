"""Rivals of the default predictor, from the literature; none of them learns the arm's model.

The third rival, networked predictive control (after Liu, Xia, Chen, Rees and Hu, IEEE Transactions
on Industrial Electronics 54, 2007), is `prediction.foresee` that learns nothing, with `bridge_ms`.
"""

from __future__ import annotations

import math

from bus_schema.arrays import Matrix, Vector
from bus_schema.runtime.compiled import all_finite, assign, compiled, scratch
from controller.compensation.command_timeline import CAPACITY, HELD, LONGEST_HORIZON_NS
from controller.compensation.motion_predictor import move
from controller.compensation.prediction import Arm, acted_since_last, aim, move_ahead
from controller.rigid_bodies.dynamics import mass_and_load
from controller.rigid_bodies.vectors import invert

_SLOW = 1.0 / 6.0
"""Lower end of the band of a network disturbance, as a share of the filter's bandwidth."""
_LARGEST = 1e6
"""Of a plausible memory, in rad/s² and less."""
_FILTERED, _LASTING, _VELOCITY, _POSITION = range(4)
"""Rows of `Arm.memory` that the communication disturbance observer uses."""


@compiled
def foresee_smith(
    arm: Arm, bandwidth_rad_s: float, measured: Matrix, _error: Vector, _bounds: Matrix,
    predicted: Matrix, target: Matrix, stamp_ns: int, sequence: int, delay_ns: int, arrival_ns: int,
) -> float:  # fmt: skip
    """Add to the measured state what the nominal model moves during the delay; return the horizon.

        x̂(t + h) = x(t) + z(t + h) − z(t),    ż = f(z, τ) + ω (x − z)

    The Smith predictor's model z runs beside the arm with the same torques, as late as the arm's.
    An arm integrates twice, so a Smith predictor's model drifts away from it without end; the
    filter that the filtered Smith predictor needs against that (Normey-Rico and Camacho, Journal of
    Process Control 19, 2009) is here the pull towards the measured state with the observer's
    bandwidth ω. With a lasting load, x̂ keeps an error: its model does not know the load.
    """
    last_ns = arm.last_answered[0]
    knows, flight = acted_since_last(arm, stamp_ns, sequence, delay_ns, arrival_ns)
    joints, model = measured.shape[1], arm.last
    motion, impulse = scratch((3, joints)), scratch(joints)
    assign(motion[:2], model)
    if knows:
        actuator = arm.belief.actuator_nm
        move(
            arm.nominal, arm.belief, arm.drive, arm.commands, flight, last_ns, stamp_ns, arm.terms,
            motion, actuator, impulse,
        )  # fmt: skip
    pull = 1.0 - math.exp(-bandwidth_rad_s * 1e-9 * (stamp_ns - last_ns))
    if not (knows and all_finite(motion[0]) and all_finite(motion[1])):
        pull, motion[:2] = 1.0, measured
    for k in range(2):
        for i in range(joints):
            model[k, i] = motion[k, i] + pull * (measured[k, i] - motion[k, i])
    acts_ns = move_ahead(arm, model, stamp_ns, predicted)
    for k in range(2):
        for i in range(joints):
            predicted[k, i] += measured[k, i] - model[k, i]
    return aim(measured, predicted, target, acts_ns - stamp_ns)


@compiled
def foresee_network(
    arm: Arm, bandwidth_rad_s: float, measured: Matrix, _error: Vector, _bounds: Matrix,
    predicted: Matrix, target: Matrix, stamp_ns: int, sequence: int, delay_ns: int, arrival_ns: int,
) -> float:  # fmt: skip
    """Treat the delay as a disturbance of the arm, and add its effect; return the horizon.

        δ = g/(s + g) (a + g q̇) − g q̇,    x̂ = x + (δ without its lasting part, integrated)

    a is the acceleration that the newest torque would give the nominal model at once. After Natori
    and Ohnishi, IEEE Transactions on Industrial Electronics 55 (2008), who need no delay for x̂;
    the horizon only tells at which time reference and funnel are read. The observer cannot tell a
    load from a delay, and its double integrator would drift without end: the lasting part of δ is
    taken away below λ = g/6, and both integrators forget with λ. So a delay is compensated for
    motions faster than λ only.
    """
    commands, memory, step_ns = arm.commands, arm.memory, stamp_ns - arm.last_answered[0]
    joints = measured.shape[1]
    last_velocity, asked = scratch(joints), scratch(joints)
    assign(last_velocity, arm.last[1])
    acted_since_last(arm, stamp_ns, sequence, delay_ns, arrival_ns)
    begins = commands.state[0].newest == HELD or step_ns > LONGEST_HORIZON_NS
    if not begins:
        _accelerate(arm, measured, commands.state[0].newest % CAPACITY, asked)
        _observe(memory, asked, last_velocity, measured[1], bandwidth_rad_s, 1e-9 * step_ns)
        begins = not _is_plausible(memory)
    if begins:
        memory[:] = 0.0
        for i in range(joints):
            memory[_FILTERED, i] = bandwidth_rad_s * measured[1, i]
    assign(arm.last, measured)
    for i in range(joints):
        predicted[0, i] = measured[0, i] + memory[_POSITION, i]
        predicted[1, i] = measured[1, i] + memory[_VELOCITY, i]
    return aim(measured, predicted, target, commands.state[0].horizon_ns)


@compiled
def _is_plausible(memory: Matrix) -> bool:
    """Whether an observer's memory is that of an arm: after one wild state it begins again."""
    for k in range(memory.shape[0]):
        for i in range(memory.shape[1]):
            if not -_LARGEST < memory[k, i] < _LARGEST:
                return False
    return True


@compiled
def _accelerate(arm: Arm, measured: Matrix, slot: int, acceleration: Vector) -> None:
    """Write the acceleration that a command's torque would give the nominal model, rad/s²."""
    joints = measured.shape[1]
    mass, inverse, load = scratch((joints, joints)), scratch((joints, joints)), scratch(joints)
    mass_and_load(arm.nominal.bodies, arm.belief.inertia, measured[0], measured[1], mass, load)
    invert(mass, inverse)
    acceleration[:] = 0.0
    for j in range(joints):
        limit_nm = arm.nominal.limits_nm[j]
        torque_nm = min(max(arm.commands.torques_nm[slot, j], -limit_nm), limit_nm)
        for i in range(joints):
            acceleration[i] += inverse[i, j] * (torque_nm - load[j])


@compiled
def _observe(
    memory: Matrix, asked: Vector, last_velocity: Vector, velocity: Vector, bandwidth_rad_s: float,
    step_s: float,
) -> None:  # fmt: skip
    """Update the network disturbance and its integrals by a step."""
    slow_rad_s = _SLOW * bandwidth_rad_s
    new, new_slow = 1.0 - math.exp(-bandwidth_rad_s * step_s), 1.0 - math.exp(-slow_rad_s * step_s)
    for i in range(velocity.size):
        seen = asked[i] + bandwidth_rad_s * last_velocity[i]
        memory[_FILTERED, i] += new * (seen - memory[_FILTERED, i])
        disturbance = memory[_FILTERED, i] - bandwidth_rad_s * velocity[i]
        memory[_LASTING, i] += new_slow * (disturbance - memory[_LASTING, i])
        change = disturbance - memory[_LASTING, i] - slow_rad_s * memory[_VELOCITY, i]
        memory[_VELOCITY, i] += step_s * change
        memory[_POSITION, i] += step_s * (memory[_VELOCITY, i] - slow_rad_s * memory[_POSITION, i])
