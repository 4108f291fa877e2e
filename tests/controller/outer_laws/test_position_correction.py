"""Position correction: a filtered share of the error, and its integral."""

import numpy as np
import pytest

from controller.control_law import Tracking
from controller.outer_laws.position_correction import PositionCorrection, PositionCorrectionGains
from controller.slow_law import AnswerTiming, SlowLaw

H, OMEGA, K_P, K_I, ERROR = 1e-3, 20.0, 0.5, 3.0, 0.01


def corrections(steps_s):
    """Of a constant error."""
    gains = PositionCorrectionGains(*(np.array([each]) for each in (K_P, K_I, OMEGA)))
    law, tracking = PositionCorrection(gains, None, np.ones(1)), Tracking(1)
    tracking.error[:] = ERROR
    found = []
    for step_s in steps_s:
        tracking.step_s = step_s
        found.append(-law.target(tracking)[0, 0])
    return np.array(found)


def test_correction_is_that_of_the_continuous_filter():
    """With e constant: k_p ē + k_i ∫ē, ē = e (1 − exp(−ω t))."""
    time_s = H * np.arange(1, 501)
    filtered = 1.0 - np.exp(-OMEGA * time_s)
    expected = ERROR * (K_P * filtered + K_I * (time_s - filtered / OMEGA))
    np.testing.assert_allclose(corrections([H] * 500), expected, atol=ERROR * K_I * H)


def test_a_slow_loop_integrates_the_time_between_its_questions():
    """Every 20 ticks, the integral of a constant error is that of every tick."""
    gains = PositionCorrectionGains(*(np.array([each]) for each in (0.0, K_I, 1e6)))
    law, tracking = PositionCorrection(gains, None, np.ones(1)), Tracking(1)
    slow = SlowLaw(law, AnswerTiming(20, 0.0, 0.0, "hold", H, seed=1, first_s=0.0))
    tracking.error[:] = ERROR
    for tick in range(101):
        tracking.time_s, tracking.step_s = H * tick, H if tick else 0.0
        slow.torque(tracking)
    assert -slow.target(tracking)[0, 0] == pytest.approx(ERROR * K_I * 100 * H)
    assert tracking.step_s == H
