"""The motion that a law acts on: its own torques at once, measurements through a filter."""

import math

import numpy as np
from prediction_bench import MODEL, MS, SWING, Bench, compensation_of

from controller.compensation.continued_motion import RETURNS
from controller.manipulator_model import ManipulatorModel
from tests.arms import PAPER_ARM

DELAY_MS, JUMP_RAD_S = 48, 0.01
STILL = 1e-9
"""Bandwidth of an observer that learns nothing in a test."""


def predictions_after_a_jump(jump_rad_s: float, ticks: int) -> list[np.ndarray]:
    """Velocities predicted after all measured velocities jumped in a moving arm."""
    bench = Bench(compensation_of(bandwidth_rad_s=STILL, first_ns=DELAY_MS * MS))
    bench.run(200, DELAY_MS)
    bench.measured.velocity += jump_rad_s
    bench.run(ticks, DELAY_MS)
    return [bench.predicted[200 + tick][2] for tick in range(ticks)]


def test_a_measured_jump_reaches_the_law_through_a_first_order_filter():
    """A velocity that nothing brakes is predicted to last: 1 − e^(−RETURNS t / d) of it is seen."""
    before, after = (predictions_after_a_jump(jump, 8) for jump in (0.0, JUMP_RAD_S))
    seen = [(new - old)[0] / JUMP_RAD_S for old, new in zip(before, after, strict=True)]
    expected = [1.0 - math.exp(-RETURNS * (tick + 1) / DELAY_MS) for tick in range(8)]
    # 8 %: what the jump changes in the Coriolis torques over the horizon
    np.testing.assert_allclose(seen, expected, rtol=0.08)


def test_own_torques_reach_the_law_at_once_however_wrong_the_inertia_is():
    """A push in the newest command changes the next prediction by M̂⁻¹ Δτ Δt."""
    push_nm = np.array([20.0, -15.0, 5.0])

    def predicted(extra_nm):
        """Velocity foreseen by the tick after one whose torque has something extra."""

        def law(tick, measured, _seen):
            return MODEL.gravity(measured.position) + (extra_nm if tick == 200 else 0.0)

        bench = Bench(
            compensation_of(bandwidth_rad_s=STILL, first_ns=DELAY_MS * MS), law=law,
            plant=ManipulatorModel(PAPER_ARM, scale=1.3), reference=SWING,
        )  # fmt: skip
        bench.run(202, DELAY_MS)
        return bench.predicted[201][1:]

    (position, velocity), (_, without) = predicted(push_nm), predicted(np.zeros(3))
    expected = np.linalg.solve(MODEL.mass_matrix(position), push_nm) * 1e-3
    np.testing.assert_allclose(velocity - without, expected, rtol=0.05, atol=1e-4)
