"""Exponential growth of an error is found, and nothing else is taken for it."""

from __future__ import annotations

import numpy as np
import pytest

from deploy.judge.findings.growing import growths
from deploy.judge.metrics import summarise
from deploy.run.simulate import simulate
from deploy.scenario.scenario import load_setup

RATE_HZ = 1000.0


def times_s(duration_s):
    return np.arange(round(duration_s * RATE_HZ)) / RATE_HZ


def growth_of(error, position=0.0):
    (found,) = growths(error[:, None], error[:, None] + position, RATE_HZ)
    return found


@pytest.mark.parametrize("duration_s", [4.0, 8.0, 30.0])
@pytest.mark.parametrize(
    ("rate", "size_rad", "slow_rad"),
    [(0.35, 1e-11, 0.0), (0.35, 1e-3, 1e-3), (1.0, 1e-3, 0.0), (3.0, 1e-11, 0.0)],
)
def test_unstable_loop_is_found_with_rate_and_frequency(duration_s, rate, size_rad, slow_rad):
    """Also beside a slower motion."""
    t = times_s(duration_s)
    sizes = size_rad * np.exp(np.minimum(rate, 30 / duration_s) * (t - duration_s))
    error = sizes * np.sin(2 * np.pi * 7.7 * t) + slow_rad * np.sin(0.5 * t)
    found = growth_of(error)
    assert found.rate_per_s == pytest.approx(min(rate, 30 / duration_s), rel=0.05)
    assert found.frequency_hz == pytest.approx(7.7, abs=1.0)


OTHERS = {
    "decay": lambda t: np.exp(-t) * np.sin(30 * t),
    "oscillation": lambda t: np.sin(30 * t),
    "limit cycle after growth": lambda t: np.minimum(1.0, np.exp(2 * t - 5)) * np.sin(30 * t),
    "resonance": lambda t: t * np.sin(30 * t),
    "beat": lambda t: np.sin(30 * t) - np.sin(30.1 * t),
    "reference that speeds up": lambda t: np.sin(5 * t + 3 * t**2),
    "amplitude of a reference": lambda t: (1.2 + np.sin(0.3 * t)) * np.sin(30 * t),
    "drift": lambda t: np.exp(0.5 * t),
    "step": lambda t: 1.0 * (t > 0.8 * t[-1]),
    "rest": lambda t: 0.0 * t,
    "not a number": lambda t: np.where(t > 5, np.nan, t),
}


@pytest.mark.parametrize("duration_s", [0.02, 2.0, 6.0, 8.0, 20.0])
@pytest.mark.parametrize("name", OTHERS)
def test_other_errors_do_not_grow(name, duration_s):
    with np.errstate(invalid="ignore"):
        assert growth_of(1e-3 * OTHERS[name](times_s(duration_s))) is None


@pytest.mark.parametrize("seed", range(60))
def test_noise_does_not_grow(seed):
    random, t = np.random.default_rng(seed), times_s(6.0)
    white = random.standard_normal(len(t))
    assert growth_of(1e-4 * white) is None
    ringing = np.zeros(len(t))  # a lightly damped loop that noise excites
    for k in range(2, len(t)):
        ringing[k] = 1.999 * np.cos(0.03) * ringing[k - 1] - 0.9990003 * ringing[k - 2] + white[k]
    assert growth_of(1e-4 * ringing) is None


def test_rounding_of_a_position_is_no_growth():
    t = times_s(8.0)
    error = 1e-16 * np.exp(0.5 * t) * np.sin(30 * t)
    assert growth_of(error, position=1.0) is None
    assert growth_of(error) is not None


@pytest.mark.parametrize("arm", ["paper_arm", "iiwa", "panda_motors"])
@pytest.mark.parametrize("law", ["pid", "smc", "fixed_time_neural", "fixed_time_adaptive"])
@pytest.mark.parametrize("duration_s", [2, 6])
def test_shipped_laws_do_not_grow(arm, law, duration_s):
    words = [f"controller.law={law}", f"duration_s={duration_s}", "metrics.from_s=1"]
    assert summarise(simulate(load_setup(arm, words)).data())["growing"] == []
