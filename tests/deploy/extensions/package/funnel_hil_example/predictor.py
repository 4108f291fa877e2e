"""A predictor for delay compensation: the joints keep their velocities."""

from __future__ import annotations

from bus_schema.arrays import Matrix, Vector
from bus_schema.runtime.compiled import compiled
from controller.compensation.prediction import Arm, acted_since_last, aim


@compiled
def keep_velocity(
    arm: Arm, _bandwidth_rad_s: float, measured: Matrix, _error: Vector, _bounds: Matrix,
    predicted: Matrix, target: Matrix, stamp_ns: int, sequence: int, delay_ns: int, arrival_ns: int,
) -> float:  # fmt: skip
    """Return the horizon, s, and write the motion at its end."""
    acted_since_last(arm, stamp_ns, sequence, delay_ns, arrival_ns)
    horizon_ns = arm.commands.state[0].horizon_ns
    for i in range(measured.shape[1]):
        predicted[0, i] = measured[0, i] + 1e-9 * horizon_ns * measured[1, i]
        predicted[1, i] = measured[1, i]
    return aim(measured, predicted, target, horizon_ns)
