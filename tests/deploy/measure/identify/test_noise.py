"""Covariances of sums of noise that is correlated in time, against closed forms and draws."""

import numpy as np
import pytest

from deploy.measure.identify.noise import _Noise, covariance_of_sums
from tests.deploy.measure.identify.virtual_logs import RATE_HZ, coloured

CUTOFF_HZ = RATE_HZ / 2.12  # the noise-equivalent bandwidth: all rows are apart
DURATION_S, DRAWS = 16.0, 60


@pytest.mark.parametrize("duration_s", [5.0, 500.0])
def test_sums_of_correlated_noise_have_the_covariance_of_their_autocorrelation(duration_s):
    """Σᵢⱼ xᵢ R(tᵢ − tⱼ) xⱼ, without terms between motions, however long the first one is."""
    random = np.random.default_rng(1)
    times_s, design = np.sort(random.uniform(0.0, duration_s, 60)), random.normal(size=(60, 3))
    runs = np.repeat([0, 1], 30)
    times_s[runs == 1] -= times_s[30]
    apart = np.abs(times_s[:, None] - times_s)
    together = runs[:, None] == runs
    exact = 2.0 * np.eye(60) + together * (0.5 * np.exp(-apart / 0.1) + 3.0 * np.exp(-apart / 4.0))
    noise = _Noise(2.0, np.array([0.1, 4.0]), np.array([0.5, 3.0]))
    with np.errstate(all="raise", under="ignore"):
        found = noise.of_sums(design, times_s, runs)
    np.testing.assert_allclose(found, design.T @ exact @ design, rtol=1e-9)


@pytest.mark.parametrize("correlation_s", [0.0, 0.1, 1.0, 10.0])
def test_intervals_of_a_line_hold_it_in_most_draws_and_are_not_too_wide(correlation_s):
    """Offset and slope of white and correlated noise, by least squares."""
    random = np.random.default_rng(5)
    times_s = np.arange(0.0, DURATION_S, 1.0 / RATE_HZ)
    design = np.column_stack([np.ones_like(times_s), np.sin(2.0 * times_s)])
    inverse = np.linalg.inv(design.T @ design)
    runs = np.zeros(len(times_s), np.int64)
    apart_s = np.abs(times_s[:, None] - times_s)
    autocorrelation = np.exp(-apart_s / correlation_s) if correlation_s else np.eye(len(times_s))
    exact = np.sqrt(np.diag(inverse @ design.T @ autocorrelation @ design @ inverse))
    off, widths = list[np.ndarray](), list[np.ndarray]()
    for _ in range(DRAWS):
        noise = coloured(random, (len(times_s), 1), correlation_s)
        left = noise - design @ (wrong := inverse @ design.T @ noise)
        sums = covariance_of_sums(design[:, None], left, times_s, runs, CUTOFF_HZ)
        sd = np.sqrt(np.diag(inverse @ sums @ inverse))
        off.append(np.abs(wrong[:, 0]) / sd)
        widths.append(sd)
    inside, wide = np.array(off) < 1.96, np.median(widths, axis=0) / exact
    assert inside[:, 1].mean() > 0.85
    assert 0.9 < wide[1] < 1.25
    if correlation_s < DURATION_S / 2.0:  # else a log cannot tell the noise from an offset
        assert inside[:, 0].mean() > 0.9
        assert 1.0 < wide[0] < 1.5
