"""Admittance: a law's torque moves the nominal model, and the robot follows that.

M̂(q) a = τ − Ĉ q̇ − Ĝ,    v* += a Δt,    q* += v* Δt
"""

from __future__ import annotations

import numpy as np

from bus_schema.arrays import Matrix, Vector
from controller.control_law import AroundLaw, ControlLaw, Tracking
from controller.manipulator_model import ManipulatorModel
from controller.rigid_bodies.vectors import invert, product


class Admittance(AroundLaw):
    """A law whose torque becomes positions and velocities.

    Args:
        law: gives the torque; it may be a slow one.
        model: of the arm.
        limits_nm: largest torques that move the model, shape (joints,): without them, a motion
            that the robot cannot follow grows without bound.
    """

    def __init__(self, law: ControlLaw, model: ManipulatorModel, limits_nm: Vector) -> None:
        self._law, self._model, self._limits_nm = law, model, limits_nm
        self._zero: Vector = np.zeros(model.joints)
        self._torque: Vector = np.zeros(model.joints)
        self._target: Matrix = np.zeros((2, model.joints))
        self._inverse_mass: Matrix = np.zeros((model.joints, model.joints))
        self._begins = True

    @property
    def log(self) -> object:
        """Log of the answers of a slow law; None of others."""
        return getattr(self._law, "log", None)

    def reset(self) -> None:
        """Forget the motion, and have the law forget everything."""
        self._law.reset()
        self._begins = True

    def close(self) -> None:
        """Free what the law holds."""
        if callable(close := getattr(self._law, "close", None)):
            close()

    def torque(self, tracking: Tracking) -> Vector:
        """Ask the law, and return zeros: the robot's own controller finds its torques."""
        np.clip(self._law.torque(tracking), -self._limits_nm, self._limits_nm, out=self._torque)
        return self._zero

    def target(self, tracking: Tracking) -> Matrix:
        """Return the motion of the nominal model; to be called after `torque`."""
        if self._begins:
            self._target[0], self._target[1], self._begins = tracking.position, 0.0, False
        place, model = tracking.position, self._model
        load = model.inverse_dynamics(place, tracking.velocity, self._zero)
        invert(model.mass_matrix(place), self._inverse_mass)
        acceleration = product(self._inverse_mass, self._torque - load)
        self._target[1] += tracking.step_s * acceleration
        self._target[0] += tracking.step_s * self._target[1]
        return self._target
