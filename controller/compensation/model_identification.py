"""The arm's model, identified while it runs: inertia, payload, friction and the actuators' lag.

A Kalman filter uses the equation of motion (see `arm_belief`), averaged over some 16 ms, which
removes encoder noise and a law's chattering:

    M̂ q̈ + ĥ + Ĵ q̈ − τ
        = f − c tanh(q̇ / v) − b q̇ − α (M̂ q̈ + ĥ) − ρ Ĵ q̈ − m (M_t q̈ + h_t) − ℓ τ̇_a

with M̂ and ĥ of the links and Ĵ of the rotors. It is linear in θ = (α, m, ℓ, f, c, b, ρ), the last
four with an entry for each joint; without rotors there is no ρ. Here f takes up the rest;
prediction has a separate, faster observer for it.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from bus_schema.arrays import Matrix, Vector
from bus_schema.runtime.compiled import compiled, scratch
from controller.compensation.arm_belief import ArmBelief, NominalArm
from controller.compensation.motion_window import WINDOW_S, Window, add_step, empty_window
from controller.rigid_bodies.dynamics import ROTOR, inverse_dynamics

INERTIA, PAYLOAD, LAG, PER_JOINT = range(4)
"""Indices in θ; from `PER_JOINT` on, f, c, b and, where there are rotors, ρ of all joints."""


class _Entry(NamedTuple):
    """Prior knowledge of an entry of θ. Ours, from three arms.

    Attributes:
        at_start: standard deviation at the start.
        per_root_s: standard deviation of its random walk over a second.
        lowest: lower limit of the estimate.
        highest: upper limit.
    """

    at_start: float
    per_root_s: float
    lowest: float
    highest: float


_FACTOR = _Entry(0.3, 0.01, -0.6, 1.5)
_PAYLOAD_KG = _Entry(2.0, 0.1, 0.0, math.inf)
_LAG_S = _Entry(2e-3, 1e-4, 0.0, 8e-3)
# Per kg m² of the inertia that governs a joint:
_DISTURBANCE = _Entry(1.0, 0.5, -math.inf, math.inf)
# Per kg m² of the same, and `_OF_LIMIT`:
_COULOMB = _Entry(5.0, 0.05, 0.0, 30.0)
_VISCOUS = _Entry(3.0, 0.05, 0.0, 30.0)
_OF_LIMIT = 0.01, 0.02
"""What friction has beside the inertia's share, Coulomb and viscous, in units of `_COULOMB` and
`_VISCOUS` per N m of the actuator's limit. A drive is as large as its friction, so 5 and 6 % of the
limit are usual, however light the arm is that it moves."""

_NOISE_RAD_S2 = 1.0
_NOISE_OF_SPREAD = 0.02
"""Standard deviation of a window's average, as a share of its largest torque less its smallest:
where a law chatters, small errors in time make large ones in the average."""
_ROUNDS_TO_LIMITS = 3
"""Correcting one entry may push another out; after these rounds, the rest is clipped."""


class Identification(NamedTuple):
    """State and settings of the filter, with n = 3 + 3 × joints, or 4 × joints with rotors.

    Attributes:
        is_active: whether there is anything to learn.
        estimate: θ, shape (n,).
        covariance: its covariance, shape (n, n).
        at_start: standard deviations at the start, shape (n,); 0 for entries that are not learned.
        per_root_s: standard deviation of θ's random walk over a second, shape (n,).
        lowest: shape (n,).
        highest: shape (n,).
        noise_nm: standard deviation of a window's average where torques rest, shape (joints,).
        window: the window that is being averaged.
    """

    is_active: bool
    estimate: Vector
    covariance: Matrix
    at_start: Vector
    per_root_s: Vector
    lowest: Vector
    highest: Vector
    noise_nm: Vector
    window: Window


def identification(
    inertia_kg_m2: Vector, limits_nm: Vector, *, model: bool, friction: bool, rotors: bool = False
) -> Identification:
    """Return a filter before its first measurement.

    Args:
        inertia_kg_m2: inertia that governs each joint, shape (joints,).
        limits_nm: largest torques of the actuators, shape (joints,); inf for none.
        model: learn inertia, payload, lag and viscous friction.
        friction: learn Coulomb friction.
        rotors: whether the nominal model has rotors, whose inertia is then learned too.
    """
    one = np.ones_like(inertia_kg_m2)
    known_nm = np.where(np.isfinite(limits_nm), limits_nm, 0.0)
    dry, viscous = (inertia_kg_m2 + share * known_nm for share in _OF_LIMIT)
    # Each entry with the scale of its numbers, and whether it is learned.
    scalars = [(entry, np.ones(1), model) for entry in (_FACTOR, _PAYLOAD_KG, _LAG_S)]
    of_joints = [
        (_DISTURBANCE, inertia_kg_m2, model or friction),
        (_COULOMB, dry, friction),
        (_VISCOUS, viscous, model),
        (_FACTOR, one, model),
    ]
    entries = scalars + of_joints[: None if rotors else -1]
    table = np.concatenate([np.outer(entry, scale) for entry, scale, _ in entries], axis=1)
    learned = np.concatenate([np.full(scale.size, wanted) for _, scale, wanted in entries])
    at_start, per_root_s = table[:2] * learned
    lowest, highest = table[2:].copy()
    return Identification(
        bool(at_start.any()), np.zeros(at_start.size), np.diag(at_start**2),
        at_start, per_root_s, lowest, highest, _NOISE_RAD_S2 * inertia_kg_m2,
        empty_window(inertia_kg_m2.size),
    )  # fmt: skip


@compiled
def start_again(filter_: Identification) -> None:
    """Forget everything learned."""
    filter_.estimate[:] = 0.0
    _forget_certainty(filter_)
    filter_.window.elapsed_s[0] = 0.0


@compiled
def _forget_certainty(filter_: Identification) -> None:
    filter_.covariance[:] = 0.0
    for k in range(filter_.estimate.size):
        filter_.covariance[k, k] = filter_.at_start[k] ** 2


@compiled
def take_in(
    nominal: NominalArm, filter_: Identification, belief: ArmBelief, before: Matrix, after: Matrix,
    actuator_before: Vector, impulse: Vector, step_s: float,
) -> bool:  # fmt: skip
    """Process a step of motion; return whether the belief changed.

    Args:
        nominal: the nominal arm.
        filter_: the filter.
        belief: the belief, changed in place when a window is full.
        before: measured position and velocity at the start of the step, shape (2, joints).
        after: the same at its end.
        actuator_before: τ_a at its start, N m, shape (joints,).
        impulse: ∫ τ dt over the step, N m s, shape (joints,).
        step_s: its length.
    """
    window = filter_.window
    add_step(window, nominal.limits_nm, before, after, actuator_before, impulse, step_s)
    if window.elapsed_s[0] < WINDOW_S * (1.0 - 1e-9):
        return False
    _update(nominal, filter_, belief, after[1])
    window.elapsed_s[0] = 0.0
    return True


@compiled
def _update(
    nominal: NominalArm, filter_: Identification, belief: ArmBelief, velocity: Vector
) -> None:
    """Process a full window that ended with this velocity."""
    window, joints = filter_.window, velocity.size
    elapsed_s = window.elapsed_s[0]
    position, mean_velocity, acceleration = scratch(joints), scratch(joints), scratch(joints)
    for i in range(joints):
        position[i] = window.position[i] / elapsed_s
        mean_velocity[i] = window.angle[i] / elapsed_s
        acceleration[i] = (velocity[i] - window.first_velocity[i]) / elapsed_s
    nominal_torque, tip_torque = scratch(joints), scratch(joints)
    needed, changed = scratch(joints), scratch(joints)
    for inertia, torque in (
        (nominal.inertia, nominal_torque), (nominal.tip_inertia, tip_torque),
        (belief.inertia, needed),
    ):  # fmt: skip
        inverse_dynamics(nominal.bodies, inertia, position, mean_velocity, acceleration, torque)

    size = filter_.estimate.size
    rotor = PER_JOINT + 3 * joints
    for k in range(size):
        filter_.covariance[k, k] += elapsed_s * filter_.per_root_s[k] ** 2
    row = scratch(size)
    for i in range(joints):
        if window.saturated[i] > 0.0:
            continue
        row[:] = 0.0
        turning = nominal.inertia[i, ROTOR] * acceleration[i]
        row[INERTIA], row[PAYLOAD] = turning - nominal_torque[i], -tip_torque[i]
        if rotor < size:
            row[rotor + i] = -turning
        row[LAG] = -(belief.actuator_nm[i] - window.first_actuator[i]) / elapsed_s
        row[PER_JOINT + i] = 1.0
        row[PER_JOINT + joints + i] = -window.sign[i] / elapsed_s
        row[PER_JOINT + 2 * joints + i] = -mean_velocity[i]
        measured = nominal_torque[i] - window.impulse[i] / elapsed_s
        spread_nm = window.highest_nm[i] - window.lowest_nm[i]
        _correct(filter_, row, measured, filter_.noise_nm[i] + _NOISE_OF_SPREAD * spread_nm)
    _believe(nominal, filter_, belief)

    inverse_dynamics(nominal.bodies, belief.inertia, position, mean_velocity, acceleration, changed)
    for i in range(joints):
        # the model now explains this part of the disturbance: the prediction does not jump
        belief.disturbance_nm[i] += changed[i] - needed[i]


@compiled
def _correct(filter_: Identification, row: Vector, measured: float, noise: float) -> None:
    """Apply one scalar measurement, in Joseph's form, which keeps the covariance positive."""
    theta, covariance = filter_.estimate, filter_.covariance
    size = theta.size
    gain, spread = scratch(size), scratch(size)
    spread[:] = 0.0
    total = noise * noise
    surprise = measured
    for k in range(size):
        for j in range(size):
            spread[k] += covariance[k, j] * row[j]
        total += row[k] * spread[k]
        surprise -= row[k] * theta[k]
    if not (0.0 < total < 1e300 and -1e300 < surprise < 1e300):
        _forget_certainty(filter_)
        return
    for k in range(size):
        gain[k] = spread[k] / total
        theta[k] += gain[k] * surprise
    for k in range(size):
        for j in range(k + 1):
            value = (
                covariance[k, j] - gain[k] * spread[j] - spread[k] * gain[j]
                + gain[k] * gain[j] * total
            )  # fmt: skip
            covariance[k, j] = covariance[j, k] = value


@compiled
def _keep_within_limits(filter_: Identification) -> None:
    """Return each entry outside its limits to them, and correct correlated entries accordingly.

    So the estimate stays the most likely one within the limits (D. Simon, "Kalman filtering with
    state constraints", IET Control Theory & Applications 4, 2010, section 2.4). If only the entry
    itself were clipped, the others would still match its rejected value, and every window would
    drive them further away.
    """
    theta, covariance = filter_.estimate, filter_.covariance
    for _ in range(_ROUNDS_TO_LIMITS):
        for k in range(theta.size):
            beyond = theta[k] - min(max(theta[k], filter_.lowest[k]), filter_.highest[k])
            if beyond != 0.0 and covariance[k, k] > 0.0:
                share = beyond / covariance[k, k]
                for j in range(theta.size):
                    theta[j] -= share * covariance[j, k]
    for k in range(theta.size):
        theta[k] = min(max(theta[k], filter_.lowest[k]), filter_.highest[k])


@compiled
def _believe(nominal: NominalArm, filter_: Identification, belief: ArmBelief) -> None:
    """Update the belief from the estimate, within its limits."""
    theta, joints = filter_.estimate, belief.coulomb_nm.size
    _keep_within_limits(filter_)
    share, payload_kg = 1.0 + theta[INERTIA], theta[PAYLOAD]
    for index in np.ndindex(belief.inertia.shape):
        payload_inertia = payload_kg * nominal.tip_inertia[index]
        belief.inertia[index] = share * nominal.inertia[index] + payload_inertia
    if theta.size > PER_JOINT + 3 * joints:
        for i in range(joints):
            factor = 1.0 + theta[PER_JOINT + 3 * joints + i]
            belief.inertia[i, ROTOR] = factor * nominal.inertia[i, ROTOR]
    belief.lag_s[0] = theta[LAG]
    window = filter_.window
    for i in range(joints):
        coulomb = theta[PER_JOINT + joints + i]
        viscous = theta[PER_JOINT + 2 * joints + i]
        mean_sign = window.sign[i] / window.elapsed_s[0]
        mean_velocity = window.angle[i] / window.elapsed_s[0]
        belief.disturbance_nm[i] += (coulomb - belief.coulomb_nm[i]) * mean_sign
        belief.disturbance_nm[i] += (viscous - belief.viscous_nm_s[i]) * mean_velocity
        belief.coulomb_nm[i], belief.viscous_nm_s[i] = coulomb, viscous
