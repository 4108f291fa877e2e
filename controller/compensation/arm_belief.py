"""The controller's model of its arm while it runs: the nominal model, and corrections learned.

    (1 + α) (M̂ q̈ + ĥ) + (1 + ρ) Ĵ q̈ + m (M_t q̈ + h_t) = τ_a + f − c tanh(q̇ / v) − b q̇,
    ℓ τ̇_a = τ − τ_a

with an inertia factor 1 + α of the links and 1 + ρ of the rotors, a payload m at the tip, Coulomb
and viscous friction c and b, a lag ℓ of the actuators, and a disturbance f for all other torques.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from bus_schema.arrays import Matrix, Vector
from bus_schema.runtime.compiled import assign, compiled
from controller.manipulator_model import ManipulatorModel
from controller.rigid_bodies.dynamics import RigidBodies

SMOOTHING_RAD_S = 0.02
"""Velocity v at which dry friction has most of its size; below, it is all but viscous."""


class NominalArm(NamedTuple):
    """The nominal model before anything is learned.

    Attributes:
        bodies: structure of the arm.
        inertia: nominal inertia table, shape (bodies, 11).
        tip_inertia: change of that table per kg at the tip, shape (bodies, 11).
        limits_nm: largest torques of the actuators, shape (joints,); inf for none.
    """

    bodies: RigidBodies
    inertia: Matrix
    tip_inertia: Matrix
    limits_nm: Vector


class ArmBelief(NamedTuple):
    """Learned model and state; arrays of shape (joints,) unless stated otherwise.

    Attributes:
        inertia: (1 + α), (1 + ρ) and m applied to the nominal table, shape (bodies, 11).
        disturbance_nm: f, driving.
        coulomb_nm: c, braking.
        viscous_nm_s: b, braking.
        lag_s: ℓ, shape (1,).
        actuator_nm: τ_a at the newest state.
    """

    inertia: Matrix
    disturbance_nm: Vector
    coulomb_nm: Vector
    viscous_nm_s: Vector
    lag_s: Vector
    actuator_nm: Vector


def nominal_arm(model: ManipulatorModel, loaded: ManipulatorModel, limits_nm: Vector) -> NominalArm:
    """Return the nominal arm for compiled code.

    Args:
        model: the nominal model.
        loaded: the same model with 1 kg more at its tip.
        limits_nm: largest torques of the actuators, shape (joints,).
    """
    inertia = model.inertia_table()
    return NominalArm(model.rigid_bodies(), inertia, loaded.inertia_table() - inertia, limits_nm)


def first_belief(nominal: NominalArm) -> ArmBelief:
    """Return the belief before anything is learned: the nominal model."""
    joints = nominal.limits_nm.size
    belief = ArmBelief(
        np.empty_like(nominal.inertia),
        np.zeros(joints), np.zeros(joints), np.zeros(joints), np.zeros(1), np.zeros(joints),
    )  # fmt: skip
    forget(nominal, belief)
    return belief


@compiled
def smooth_sign(velocity: float) -> tuple[float, float]:
    """Return tanh(q̇ / v) and its slope by q̇ from one exponential: a third of tanh's time."""
    rest = 2.0 / (math.exp((2.0 / SMOOTHING_RAD_S) * velocity) + 1.0)
    return 1.0 - rest, rest * (2.0 - rest) / SMOOTHING_RAD_S


@compiled
def forget(nominal: NominalArm, belief: ArmBelief) -> None:
    """Reset the belief to the nominal model."""
    assign(belief.inertia, nominal.inertia)
    belief.disturbance_nm[:] = 0.0
    belief.coulomb_nm[:] = 0.0
    belief.viscous_nm_s[:] = 0.0
    belief.lag_s[:] = 0.0
    belief.actuator_nm[:] = 0.0
