"""Admittance: a law's torque moves the nominal model, and the robot follows that.

M̂(q) a = τ − Ĉ q̇ − Ĝ,    v* += a Δt,    q* += v* Δt
"""

from __future__ import annotations

import numpy as np

from bus_schema.arrays import Matrix, Vector
from bus_schema.runtime.compiled import bind, compiled
from controller.control_law import ControlLaw, Tracking
from controller.manipulator_model import ManipulatorModel
from controller.rigid_bodies.dynamics import RigidBodies, mass_and_load
from controller.rigid_bodies.vectors import invert, product
from controller.slow_law import Starvation


class Admittance:
    """A law whose torque becomes positions and velocities.

    Args:
        law: gives the torque; between the answers of a slow one, the model moves on.
        model: of the arm.
        limits_nm: largest torques that move the model, shape (joints,): without them, a motion
            that the robot cannot follow grows without bound.
    """

    def __init__(self, law: ControlLaw, model: ManipulatorModel, limits_nm: Vector) -> None:
        self._law, self._limits_nm = law, limits_nm
        self._bodies, self._inertia = model.rigid_bodies(), model.inertia_table()
        self.diagnostics = law.diagnostics
        self._zero: Vector = np.zeros(model.joints)
        self._torque: Vector = np.zeros(model.joints)
        self._target: Matrix = np.zeros((2, model.joints))
        self._tracking: Tracking | None = None
        self._begins = True

    @property
    def starvation(self) -> Starvation | None:
        """When a law of chunks ran out of rows; None for any other law."""
        return getattr(self._law, "starvation", None)

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
        if tracking is not self._tracking:
            self._tracking = tracking
            self._move = bind(
                _move, self._bodies, self._inertia, tracking.motion, self._torque, self._target,
                free=["float64"],
            )  # fmt: skip
        if self._begins:
            self._target[0], self._target[1], self._begins = tracking.position, 0.0, False
        self._move(tracking.step_s)
        return self._target


@compiled
def _move(
    bodies: RigidBodies, inertia: Matrix, motion: Matrix, torque_nm: Vector, target: Matrix,
    step_s: float,
) -> None:  # fmt: skip
    """Move a target by a step with the acceleration that a torque gives the model."""
    joints = torque_nm.size
    mass, inverse, load = np.empty((joints, joints)), np.empty((joints, joints)), np.empty(joints)
    mass_and_load(bodies, inertia, motion[0], motion[1], mass, load)
    invert(mass, inverse)
    acceleration = product(inverse, torque_nm - load)
    for i in range(joints):
        target[1, i] += step_s * acceleration[i]
        target[0, i] += step_s * target[1, i]
