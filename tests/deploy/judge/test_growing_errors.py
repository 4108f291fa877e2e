"""Exponential growth of an error is found, and nothing else is taken for it."""

from __future__ import annotations

import numpy as np
import pytest

from deploy.judge.findings.growing import growths, longest_growth_time_s
from deploy.judge.metrics import summarise
from deploy.run.simulate import simulate
from deploy.scenario.scenario import load_setup

RATE_HZ = 1000.0


def times_s(duration_s):
    return np.arange(round(duration_s * RATE_HZ)) / RATE_HZ


def growth_of(error, position=0.0):
    (found,) = growths(error[:, None], error[:, None] + position, RATE_HZ).joints
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


@pytest.mark.parametrize("duration_s", [4.0, 8.0, 30.0])
@pytest.mark.parametrize("periods", [2.05, 3.0, 5.5])
@pytest.mark.parametrize("factor", [1.7, 2.7, 7.4])
@pytest.mark.parametrize("slow_rad", [0.0, 1e-3])
def test_slow_unstable_loop_is_found_from_two_periods_up(duration_s, periods, factor, slow_rad):
    """In the last half of the run; a spectrum of 7 segments needs 12."""
    t, half_s = times_s(duration_s), 0.5 * duration_s
    rate, hertz = np.log(factor) / half_s, periods / half_s
    error = 1e-3 * np.exp(rate * (t - duration_s)) * np.sin(2 * np.pi * hertz * t + 1.0)
    found = growth_of(error + slow_rad * np.sin(0.4 * t))
    assert found.rate_per_s == pytest.approx(rate, rel=0.02)
    assert found.frequency_hz == pytest.approx(hertz, rel=0.01)


@pytest.mark.parametrize("size_rad", [1e-9, 1.0, 1e200])
def test_errors_that_decay_fast_or_diverge_far_are_no_trouble(size_rad):
    """Neither the smallest nor the largest of numbers overflow."""
    t = times_s(8.0)
    fast = np.exp(-300.0 * np.maximum(0.0, t - 4.0)) + 1e-3 * np.sin(0.5 * t)
    diverging = np.exp(60.0 * (t - 8.0)) * np.sin(2 * np.pi * 0.7 * t)
    errors = size_rad * np.stack([fast, diverging], axis=1)
    with np.errstate(divide="raise", over="raise", invalid="raise"):
        assert growths(errors, errors, RATE_HZ).joints[0] is None


def test_what_a_run_is_too_short_to_show():
    t = times_s(8.0)
    smooth, noise = np.sin(0.5 * t), np.random.default_rng(0).standard_normal(len(t))
    errors = np.stack([smooth, smooth + 0.01 * noise], axis=1)
    # two periods in the last half for a linear model, three in a segment of 1 s for a spectrum
    assert growths(errors[:, :1], errors[:, :1], RATE_HZ).not_tested_below_hz == 0.5
    assert growths(errors, errors, RATE_HZ).not_tested_below_hz == 3.0
    assert growths(errors[:20], errors[:20], RATE_HZ).not_tested_below_hz is None
    # e^(3 s / T) = 1.6 between the middles of the first segment and the last
    assert longest_growth_time_s(8.0) == pytest.approx(3.0 / np.log(1.6))


def grown(t):
    """A size that grows until 0.45 of the time."""
    return np.minimum(1.0, np.exp(2.0 * (t - 0.45 * t[-1])))


OTHERS = {
    "slow decay": lambda t: np.exp(-0.3 * t) * np.sin(4 * t),
    "slow oscillation": lambda t: np.sin(4 * t) + np.sin(0.5 * t),
    "slow resonance": lambda t: t * np.sin(4 * t),
    "slow beat": lambda t: np.sin(4 * t) - np.sin(4.1 * t),
    "slow amplitude": lambda t: (1.2 + np.sin(0.3 * t)) * np.sin(4 * t),
    "slow limit cycle after growth": lambda t: grown(t) * np.sin(5 * t),
    "polynomial": lambda t: t**3 - 3 * t,
    "minimum jerk": lambda t: np.polyval([6, -15, 10, 0, 0, 0], t / t[-1]),
    "dry friction": lambda t: np.tanh(20 * np.sin(2 * t)) * (1 + 0.1 * t),
    "triangle": lambda t: np.arcsin(np.sin(4 * t)),
    "steps": lambda t: np.floor(3 * np.sin(2 * t)),
    "cusps": lambda t: np.abs(np.sin(3 * t)),
    "decay": lambda t: np.exp(-t) * np.sin(30 * t),
    "oscillation": lambda t: np.sin(30 * t),
    "limit cycle after growth": lambda t: grown(t) * np.sin(30 * t),
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


@pytest.mark.parametrize(
    ("arm", "duration_s"), [("paper_arm", 6), ("iiwa", 2), ("panda_motors", 2)]
)
@pytest.mark.parametrize("law", ["pid", "smc", "fixed_time_neural", "fixed_time_adaptive"])
def test_shipped_laws_do_not_grow(arm, law, duration_s):
    words = [f"controller.law={law}", f"duration_s={duration_s}", "metrics.from_s=1"]
    assert summarise(simulate(load_setup(arm, words)).data())["growing"] == []
