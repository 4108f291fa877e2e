"""Position correction: a filtered share of the error, and its integral."""

import numpy as np
import pytest

from controller.chunks.answer import Holding
from controller.control_law import Tracking
from controller.outer_laws.position_correction import PositionCorrection, PositionCorrectionGains
from controller.slow_law import AnswerTiming, SlowLaw

H, OMEGA, K_P, K_I, ERROR = 1e-3, 20.0, 0.5, 3.0, 0.01


def corrected():
    """The law, and the situation of a constant error."""
    gains = PositionCorrectionGains(*(np.array([each]) for each in (K_P, K_I, OMEGA)))
    law, tracking = PositionCorrection(gains, None, np.ones(1)), Tracking(1)
    tracking.error[:] = ERROR
    return law, tracking


def continuous(time_s):
    """With e constant: k_p ē + k_i ∫ē, ē = e (1 − exp(−ω t))."""
    filtered = 1.0 - np.exp(-OMEGA * time_s)
    return ERROR * (K_P * filtered + K_I * (time_s - filtered / OMEGA))


def corrections(steps_s):
    (law, tracking), found = corrected(), []
    for step_s in steps_s:
        tracking.step_s = step_s
        found.append(-law.target(tracking)[0, 0])
    return np.array(found)


def test_correction_is_that_of_the_continuous_filter():
    expected = continuous(H * np.arange(1, 501))
    np.testing.assert_allclose(corrections([H] * 500), expected, atol=ERROR * K_I * H)


@pytest.mark.parametrize("every", [1, 5, 17, 40])
def test_a_slow_correction_integrates_all_the_time_between_its_questions(every):
    """As the continuous filter, within the rectangle of one of its steps."""
    law, tracking = corrected()
    slow = SlowLaw(law, AnswerTiming(every, 0.0, 0.0, Holding(), H, seed=1, first_s=0.0))
    found = []
    for tick in range(501):
        tracking.time_s, tracking.step_s = tick * H, H if tick else 0.0
        slow.torque(tracking)
        found.append(-slow.target(tracking)[0, 0])
    time_s = H * every * np.arange(len(found[::every]))
    atol = ERROR * K_I * every * H
    np.testing.assert_allclose(found[::every], continuous(time_s), atol=atol)
    assert found[-1] > 10 * atol
