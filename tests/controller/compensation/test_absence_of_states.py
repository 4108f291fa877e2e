"""What a law sees after states stayed away."""

import pytest
from prediction_bench import FUNNEL, MS, START, SWING, compensation_of

from controller.compensation.command_timeline import HorizonSettings
from controller.control_law import Tracking


@pytest.mark.parametrize(
    ("period_ms", "absence_ms", "step_ms"),
    [(1, 2, 2), (1, 16, 16), (1, 17, 0), (1, 500, 0), (20, 60, 60), (20, 340, 0)],
)
def test_a_law_integrates_over_lost_states_but_not_over_an_absence(period_ms, absence_ms, step_ms):
    """16 periods are integrated; after a longer absence a law begins as at its first state."""
    settings = HorizonSettings(first_ns=48 * MS, tick_ns=period_ms * MS)
    compensation, measured = compensation_of(horizon=settings), Tracking(3)
    measured.position[:] = START
    seen = []
    for at_ms in (0, absence_ms):
        measured.update(1e-3 * at_ms, 1e-3 * at_ms, SWING, FUNNEL)
        compensation.predict(measured, at_ms * MS, None, SWING, FUNNEL)
        seen.append(compensation.predicted.step_s)
    assert seen == pytest.approx([0.0, 1e-3 * step_ms])
