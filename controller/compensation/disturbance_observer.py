"""What the nominal model misses, learned from how the arm moved and how it should have moved.

The missing torque of a joint is f − c tanh(q̇ / v): a disturbance f that may change at any time, and
Coulomb friction c, which flips its sign with the velocity. Only with c apart from f can a predictor
predict the flip. A Kalman filter per joint tells the two apart: f walks at random, c hardly moves.
"""

from __future__ import annotations

import math

import numpy as np

from bus_schema.arrays import Matrix, Vector
from bus_schema.runtime.compiled import compiled

# Per kg m² of a joint's own inertia, so that they suit every arm; ours, from three arms.
_WALK_RAD_S2 = 0.25
"""How far f walks in a second."""
_UNKNOWN_FRICTION_RAD_S2 = 3.0
"""Size of the Coulomb friction that may be there at the start."""
_FRICTION_WALK_RAD_S2 = 0.05
"""How far c walks in a second."""
_MOST_FRICTION_RAD_S2 = 30.0
"""No joint is believed to have more Coulomb friction than this."""


class DisturbanceObserver:
    """Estimates disturbance and Coulomb friction of every joint.

    With c known, f follows a constant disturbance with 1 − e^(−bandwidth × time): its gain is the
    steady one of the filter from the start on, whatever the time between two states.

    Args:
        joints: number of joints.
        bandwidth_rad_s: bandwidth of f.
        learn_friction: whether c is learned; otherwise it stays zero, and f takes all.

    Attributes:
        disturbance_nm: f, driving; shape (joints,).
        coulomb_nm: c, braking; shape (joints,).
    """

    def __init__(self, joints: int, bandwidth_rad_s: float, *, learn_friction: bool) -> None:
        self._bandwidth_rad_s = bandwidth_rad_s
        self._unknown = _UNKNOWN_FRICTION_RAD_S2**2 if learn_friction else 0.0
        self._drift = _FRICTION_WALK_RAD_S2**2 if learn_friction else 0.0
        self._covariance: Matrix = np.zeros((joints, 3))
        self.disturbance_nm: Vector = np.zeros(joints)
        self.coulomb_nm: Vector = np.zeros(joints)
        self.reset()

    def reset(self) -> None:
        """Forget what was learned."""
        self.disturbance_nm[:] = 0.0
        self.coulomb_nm[:] = 0.0
        self._covariance[:] = 0.0
        self._covariance[:, 2] = self._unknown

    def learn(
        self, missed_nm: Vector, inertia_kg_m2: Vector, smooth_sign: Vector, step_s: float
    ) -> None:
        """Take in one step of motion.

        Args:
            missed_nm: M̂ (q̇ − q̇ predicted) / step, shape (joints,).
            inertia_kg_m2: what each joint feels, shape (joints,).
            smooth_sign: tanh(q̇ / v) during the step, shape (joints,).
            step_s: its length.
        """
        gain = 1.0 - math.exp(-self._bandwidth_rad_s * step_s)
        _learn(
            missed_nm, inertia_kg_m2, smooth_sign, gain, _WALK_RAD_S2**2 * step_s,
            self._drift * step_s, self._covariance, self.disturbance_nm, self.coulomb_nm,
        )  # fmt: skip


@compiled
def _learn(
    missed: Vector, inertia: Vector, smooth_sign: Vector, gain: float, walk: float,
    friction_walk: float, covariance: Matrix, disturbance: Vector, coulomb: Vector,
) -> None:  # fmt: skip
    """Take in one step; `walk` and `friction_walk` are variances of what f and c did meanwhile."""
    # by which `gain` is the steady gain for f alone
    noise = walk * (1.0 - gain) / (gain * gain)
    for i in range(disturbance.size):
        p_ff, p_fc, p_cc = covariance[i]
        p_ff = max(p_ff, noise * gain) + walk
        p_cc += friction_walk
        # the row of the measurement is (1, −smooth_sign)
        spread_f = p_ff - p_fc * smooth_sign[i]
        spread_c = p_fc - p_cc * smooth_sign[i]
        total = spread_f - spread_c * smooth_sign[i] + noise
        covariance[i, 0] = p_ff - spread_f * spread_f / total
        covariance[i, 1] = p_fc - spread_f * spread_c / total
        covariance[i, 2] = p_cc - spread_c * spread_c / total
        disturbance[i] += spread_f / total * missed[i]
        limit = _MOST_FRICTION_RAD_S2 * inertia[i]
        coulomb[i] = min(max(coulomb[i] + spread_c / total * missed[i], 0.0), limit)
