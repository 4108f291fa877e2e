"""Where the arm will be: nominal dynamics, the torques in flight, and what was learned to miss.

The rigid-body terms M̂ and Ĉ q̇ + Ĝ change slowly: they are taken anew every few milliseconds, for
the middle of the stretch they stand for. Friction is stiff: it is integrated in steps of at most a
millisecond, implicitly in the velocity.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from bus_schema.arrays import Matrix, Vector
from bus_schema.runtime.compiled import compiled
from controller.compensation.command_timeline import HELD, TorqueSchedule
from controller.compensation.disturbance_observer import DisturbanceObserver
from controller.manipulator_model import ManipulatorModel

SMOOTHING_RAD_S = 0.02
"""Velocity at which friction has most of its size; below, it is all but viscous."""
_STRETCH_NS = 16_000_000
_STEP_NS = 1_000_000


class Forces(NamedTuple):
    """What acts on the joints over a stretch of time beside the commanded torques.

    Attributes:
        inverse_mass: M̂⁻¹, shape (joints, joints).
        load_nm: Ĉ q̇ + Ĝ, shape (joints,).
        disturbance_nm: f, shape (joints,).
        coulomb_nm: c, shape (joints,).
    """

    inverse_mass: Matrix
    load_nm: Vector
    disturbance_nm: Vector
    coulomb_nm: Vector


class MotionPredictor:
    """Integrates M̂ q̈ + Ĉ q̇ + Ĝ = τ + f − c tanh(q̇ / v) through a schedule of torques.

    Args:
        model: the nominal model.
        missing: estimates of f and c.

    Attributes:
        position: rad; velocity: rad/s: the predicted state, shape (joints,).
    """

    def __init__(self, model: ManipulatorModel, missing: DisturbanceObserver) -> None:
        self._model = model
        self._missing = missing
        self._motion: Matrix = np.zeros((3, model.joints))
        self.position: Vector = self._motion[0]
        self.velocity: Vector = self._motion[1]
        self._acceleration: Vector = self._motion[2]
        self._no_acceleration: Vector = np.zeros(model.joints)

    def predict(
        self,
        position: Vector,
        velocity: Vector,
        schedule: TorqueSchedule,
        from_ns: int,
        until_ns: int,
    ) -> None:
        """Move from a state at `from_ns` to `until_ns`; until a first command acts, stand still."""
        self.position[:], self.velocity[:] = position, velocity
        self._acceleration[:] = 0.0
        now_ns, in_force, upcoming = from_ns, schedule.in_force, schedule.upcoming
        if in_force == HELD:
            is_waiting = upcoming > schedule.newest
            now_ns = until_ns if is_waiting else max(from_ns, schedule.acts_ns(upcoming))
        while now_ns < until_ns:
            end_ns = min(now_ns + _STRETCH_NS, until_ns)
            forces = self._forces_midway(0.5e-9 * (end_ns - now_ns))
            in_force, upcoming = _advance(
                self._motion, forces, schedule, in_force, upcoming, now_ns, end_ns
            )
            now_ns = end_ns

    def _forces_midway(self, half_s: float) -> Forces:
        """What acts over a stretch, taken at its middle, `half_s` from now."""
        velocity = self.velocity + half_s * self._acceleration
        position = self.position + half_s * velocity
        return Forces(
            self._model.inverse_mass_matrix(position),
            self._model.inverse_dynamics(position, velocity, self._no_acceleration),
            self._missing.disturbance_nm,
            self._missing.coulomb_nm,
        )


@compiled
def _advance(
    motion: Matrix, forces: Forces, schedule: TorqueSchedule, in_force: int, upcoming: int,
    from_ns: int, until_ns: int,
) -> tuple[int, int]:  # fmt: skip
    """Advance to `until_ns` in place; the command in force then, and the one after it.

    Args:
        motion: position, velocity and, in the end, mean acceleration as rows, shape (3, joints).
        forces: what acts beside the torques.
        schedule: the torques.
        in_force: number of the command in force at `from_ns`.
        upcoming: number of the next one.
        from_ns: start.
        until_ns: end.
    """
    position, velocity, acceleration = motion[0], motion[1], motion[2]
    inverse_mass, coulomb = forces.inverse_mass, forces.coulomb_nm
    slots, total, before = schedule.stamps_ns.size, np.empty(position.size), velocity.copy()
    now_ns = from_ns
    while now_ns < until_ns:
        end_ns = min(now_ns + _STEP_NS, until_ns)
        while upcoming <= schedule.newest:
            acts_ns = schedule.stamps_ns[upcoming % slots] + schedule.delay_ns
            if acts_ns > now_ns:
                end_ns = min(end_ns, acts_ns)
                break
            in_force, upcoming = upcoming, upcoming + 1
        torque, step_s = schedule.torques_nm[in_force % slots], (end_ns - now_ns) * 1e-9
        for i in range(position.size):
            friction = coulomb[i] * math.tanh(velocity[i] / SMOOTHING_RAD_S)
            total[i] = torque[i] + forces.disturbance_nm[i] - friction - forces.load_nm[i]
        for i in range(position.size):
            flatness = 1.0 / math.cosh(min(abs(velocity[i] / SMOOTHING_RAD_S), 300.0))
            damping = coulomb[i] / SMOOTHING_RAD_S * flatness * flatness
            pull = 0.0
            for j in range(position.size):
                pull += inverse_mass[i, j] * total[j]
            change = step_s * pull / (1.0 + step_s * inverse_mass[i, i] * damping)
            position[i] += step_s * (velocity[i] + 0.5 * change)
            velocity[i] += change
        now_ns = end_ns
    for i in range(position.size):
        acceleration[i] = (velocity[i] - before[i]) / ((until_ns - from_ns) * 1e-9)
    return in_force, upcoming
