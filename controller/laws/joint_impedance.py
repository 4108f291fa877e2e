"""Joint impedance: a spring and a damper at every joint, on a model of gravity and Coriolis.

    τ = −K e − D ė + Ĉ q̇ + Ĝ

After Hogan, Impedance control (1985), with the arm's own inertia left as it is; the first example
of libfranka. The acceleration of the reference is not fed forward.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from bus_schema.arrays import Vector
from bus_schema.configuration import PerJointPositive
from controller.control_law import Diagnostics, Dynamics, Tracking
from controller.laws.sliding_mode import default_stiffness


class JointImpedanceGains(NamedTuple):
    """Stiffness K, N m/rad, and damping D, N m s/rad, per joint."""

    stiffness: PerJointPositive
    damping: PerJointPositive

    @classmethod
    def from_inertia(cls, inertia_kg_m2: Vector) -> JointImpedanceGains:
        """Return critically damped joints of the default stiffness."""
        stiffness = default_stiffness(inertia_kg_m2)
        return cls(stiffness * inertia_kg_m2, 2.0 * np.sqrt(stiffness) * inertia_kg_m2)


class JointImpedance:
    """The law; it has no memory."""

    def __init__(
        self, gains: JointImpedanceGains, model: Dynamics, _torque_limits_nm: Vector
    ) -> None:
        joints = gains.stiffness.size
        self.diagnostics = Diagnostics(joints)
        self._gains, self._model = gains, model
        self._at_rest: Vector = np.zeros(joints)

    def reset(self) -> None:
        """Do nothing: there is no state."""

    def torque(self, tracking: Tracking) -> Vector:
        model = self._model.inverse_dynamics(tracking.position, tracking.velocity, self._at_rest)
        spring = self._gains.stiffness * tracking.error
        damper = self._gains.damping * tracking.error_rate
        return model - (spring + damper)
