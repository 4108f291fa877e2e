"""Position correction: a filtered share of the error, and its integral."""

import math

import numpy as np

from controller.control_law import ABSENCE_STATES, Tracking
from controller.outer_laws.position_correction import PositionCorrection, PositionCorrectionGains

H, OMEGA, K_P, K_I, ERROR = 1e-3, 20.0, 0.5, 3.0, 0.01


def corrections(steps_s):
    """Of a constant error."""
    gains = PositionCorrectionGains(*(np.array([each]) for each in (K_P, K_I, OMEGA)))
    law, tracking = PositionCorrection(gains, None, np.ones(1)), Tracking(1)
    law.follow(None, 0.0, ABSENCE_STATES * H)
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


def test_nothing_is_integrated_over_an_absence_of_states():
    found = corrections([H, H, 17 * H, 16 * H])
    assert found[2] == found[1]
    filtered = ERROR * (1.0 - math.exp(-18 * OMEGA * H))
    grown = K_P * (filtered - ERROR * (1.0 - math.exp(-2 * OMEGA * H))) + 16 * H * K_I * filtered
    np.testing.assert_allclose(found[3] - found[2], grown, rtol=1e-9)
