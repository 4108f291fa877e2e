"""Where the arm will be: nominal dynamics, the torques in flight, and a disturbance estimate.

The rigid-body terms M̂ and Ĉ q̇ + Ĝ come from the nominal model and change slowly; they are taken
anew every few milliseconds, in the middle of the stretch they stand for. Friction is stiff and is
integrated in steps of a millisecond, implicitly in the velocity.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from bus_schema.arrays import Matrix, Vector
from bus_schema.compiled import compiled
from controller.command_timeline import HELD, Schedule
from controller.manipulator_model import ManipulatorModel

STRETCH_NS = 8_000_000
STEP_NS = 1_000_000


class MotionPredictor:
    """Integrates M̂ q̈ + Ĉ q̇ + Ĝ = τ + f̂ through a schedule of torques.

    Attributes:
        position: rad; velocity: rad/s: the state, overwritten by `predict`.
        disturbance: f̂, N m, what the nominal model misses. All of shape (joints,).
    """

    def __init__(self, model: ManipulatorModel) -> None:
        joints = model.joints
        self._model = model
        self.position: Vector = np.zeros(joints)
        self.velocity: Vector = np.zeros(joints)
        self.disturbance: Vector = np.zeros(joints)
        self.coulomb: Vector = np.zeros(joints)
        self._acceleration: Vector = np.zeros(joints)
        self._at: Vector = np.zeros(joints)
        self._moving: Vector = np.zeros(joints)
        self._no_acceleration: Vector = np.zeros(joints)

    def predict(
        self, position: Vector, velocity: Vector, schedule: Schedule, from_ns: int, until_ns: int
    ) -> None:
        """Move from a state to the one at `until_ns`; an arm that nothing acts on is held."""
        self.position[:], self.velocity[:] = position, velocity
        self._acceleration[:] = 0.0
        in_force, upcoming = schedule.in_force, schedule.upcoming
        now_ns = from_ns
        if in_force == HELD:
            if upcoming > schedule.newest:
                return
            first = schedule.stamps_ns[upcoming % schedule.stamps_ns.size]
            now_ns = max(now_ns, int(first) + schedule.delay_ns)
        while now_ns < until_ns:
            stretch_ns = min(STRETCH_NS, until_ns - now_ns)
            half_s = 0.5e-9 * stretch_ns
            np.multiply(self._acceleration, half_s, out=self._moving)
            self._moving += self.velocity
            np.multiply(self._moving, half_s, out=self._at)
            self._at += self.position
            load = self._model.inverse_dynamics(self._at, self._moving, self._no_acceleration)
            in_force, upcoming = _advance(
                self.position, self.velocity, self._acceleration,
                self._model.inverse_mass_matrix(self._at), load, self.disturbance,
                self.coulomb,
                schedule, in_force, upcoming, now_ns, now_ns + stretch_ns,
            )  # fmt: skip
            now_ns += stretch_ns


@compiled
def _advance(
    position: Vector, velocity: Vector, acceleration: Vector,
    inverse_mass: Matrix, load: Vector, disturbance: Vector, coulomb: Vector,
    schedule: Schedule, in_force: int, upcoming: int, now_ns: int, until_ns: int,
) -> tuple[int, int]:  # fmt: skip
    joints, slots = position.size, schedule.stamps_ns.size
    total = np.empty(joints)
    before = velocity.copy()
    began_ns = now_ns
    smooth = 0.02
    while now_ns < until_ns:
        end_ns = min(now_ns + STEP_NS, until_ns)
        while upcoming <= schedule.newest:
            acts_ns = schedule.stamps_ns[upcoming % slots] + schedule.delay_ns
            if acts_ns > now_ns:
                end_ns = min(end_ns, acts_ns)
                break
            in_force, upcoming = upcoming, upcoming + 1
        step_s = (end_ns - now_ns) * 1e-9
        for i in range(joints):
            friction = coulomb[i] * math.tanh(velocity[i] / smooth)
            total[i] = schedule.torques_nm[in_force % slots, i] + disturbance[i] - load[i] - friction
        for i in range(joints):
            pull = 0.0
            for j in range(joints):
                pull += inverse_mass[i, j] * total[j]
            slope = coulomb[i] * (1.0 - math.tanh(velocity[i] / smooth) ** 2) / smooth
            change = step_s * pull / (1.0 + step_s * inverse_mass[i, i] * slope)
            position[i] += step_s * (velocity[i] + 0.5 * change)
            velocity[i] += change
        now_ns = end_ns
    for i in range(joints):
        acceleration[i] = (velocity[i] - before[i]) / ((until_ns - began_ns) * 1e-9)
    return in_force, upcoming
