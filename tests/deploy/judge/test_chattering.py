from __future__ import annotations

import numpy as np
import pytest

from deploy.judge.findings.chattering import CHATTER_HZ, chatter_shares, power_spectrum

RATE_HZ = 1000.0
TIMES_S = np.arange(5000) / RATE_HZ


def sine(amplitude, frequency_hz):
    return amplitude * np.sin(2 * np.pi * frequency_hz * TIMES_S + 0.3)


def test_the_power_of_sines_is_half_their_amplitude_squared():
    torques = np.stack([sine(3.0, 5.0) + 100.0, sine(2.0, 200.0)], axis=1)
    frequencies, power = power_spectrum(torques, RATE_HZ)
    assert power.sum(axis=0) == pytest.approx([4.5, 2.0], rel=1e-3)
    assert frequencies[power.argmax(axis=0)].tolist() == [5.0, 200.0]


def test_the_share_is_that_of_the_fast_part():
    torques = np.stack([sine(3.0, 5.0) + sine(1.0, 120.0), sine(1.0, 5.0)], axis=1)
    assert chatter_shares(torques, RATE_HZ) == pytest.approx([0.1, 0.0], abs=1e-6)


def test_white_noise_has_its_energy_where_its_band_is():
    noise = np.random.default_rng(0).standard_normal((20_000, 1))
    assert chatter_shares(noise, RATE_HZ) == pytest.approx([1 - 2 * CHATTER_HZ / RATE_HZ], abs=0.02)


def test_a_slow_drift_is_no_chatter():
    """Its segments do not begin where they end: without a window that would count as fast."""
    share = chatter_shares(sine(50.0, 0.08)[:, None], RATE_HZ)
    assert share[0] < 1e-8


def test_a_constant_torque_does_not_chatter():
    assert chatter_shares(np.full((3000, 2), 7.0), RATE_HZ) == [0.0, 0.0]


@pytest.mark.parametrize(("samples", "rate_hz"), [(1000, 100.0), (1, RATE_HZ), (0, RATE_HZ)])
def test_chatter_share_is_unknown_for_unsuitable_data(samples, rate_hz):
    assert chatter_shares(np.zeros((samples, 1)), rate_hz) is None


@pytest.mark.parametrize("samples", [2, 3, 700, 1499])
def test_short_recordings_are_judged_as_a_whole(samples):
    shares = chatter_shares(np.random.default_rng(1).standard_normal((samples, 2)), RATE_HZ)
    assert all(0.0 <= share <= 1.0 for share in shares)
