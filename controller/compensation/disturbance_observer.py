"""What the model misses at every moment, learned from how the arm moved and how it should have."""

from __future__ import annotations

from bus_schema.arrays import Matrix, Vector
from bus_schema.runtime.compiled import compiled

_LARGEST_NM = 1e6
"""No arm ever misses more: a state that says so is not to be learned from."""


@compiled
def observe(
    mass: Matrix, velocity: Vector, predicted_velocity: Vector, step_s: float, gain: float,
    disturbance: Vector,
) -> bool:  # fmt: skip
    """Let the disturbance follow what was missed over a step; whether that could be.

    A constant one is followed with 1 − e^(−bandwidth × time), whatever the length of the steps.

    Args:
        mass: M(q), kg m², shape (joints, joints).
        velocity: measured at the end of the step, rad/s, shape (joints,).
        predicted_velocity: what the model made of the state at its start, rad/s.
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
