"""A prediction that has diverged is not what a law computes with."""

import numpy as np
import pytest

from controller.compensation.prediction import aim

MEASURED = np.array([[0.1, -0.2], [1.0, 2.0]])


@pytest.mark.parametrize("value", [1e47, 1e5, -1e5, np.inf, np.nan])
@pytest.mark.parametrize("row", [0, 1])
def test_the_measured_state_stands_for_a_place_or_speed_that_no_arm_has(row, value):
    predicted, target = MEASURED + 0.01, np.empty((2, 2))
    predicted[row, 1] = value
    aim(MEASURED, predicted, target, 50_000_000)
    np.testing.assert_array_equal(predicted, MEASURED)
    np.testing.assert_allclose(target[0], MEASURED[0] - 0.05 * MEASURED[1])


def test_a_possible_prediction_stays():
    predicted, target = MEASURED + 0.01, np.empty((2, 2))
    aim(MEASURED, predicted, target, 50_000_000)
    np.testing.assert_array_equal(predicted, MEASURED + 0.01)
