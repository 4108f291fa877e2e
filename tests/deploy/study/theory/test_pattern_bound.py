"""The bound for every pattern: no pattern below it is unstable, and it is no more than constant."""

from __future__ import annotations

import numpy as np
import pytest

from deploy.scenario.scenario import load_setup
from deploy.study.theory.linear_law import LinearLaw
from deploy.study.theory.linear_plant import LinearPlant
from deploy.study.theory.pattern_bound import pattern_bound_s
from deploy.study.theory.sampled_loop import SampledLoop
from deploy.study.theory.theory import theory_of
from deploy.study.theory.windows import unstable_windows
from tests.deploy.own_laws import own_law
from tests.deploy.study.theory.lifted_loops import random_loop
from tests.deploy.study.theory.linear_arms import (
    ARMS,
    STEP_MS,
    UR10E,
    Arm,
    constant,
    exact_ms,
    is_kept,
    theory_ms,
    varying,
)

PATTERNS = {
    "square wave": lambda ticks: [1.0] * (ticks // 2) + [0.0] * (ticks - ticks // 2),
    "long square wave": lambda ticks: [1.0] * (2 * ticks // 3) + [0.0] * (ticks - 2 * ticks // 3),
    "sawtooth": lambda ticks: [k / (ticks - 1) for k in range(ticks)],
    "falling sawtooth": lambda ticks: [1.0 - k / (ticks - 1) for k in range(ticks)],
}
"""Delays of a period of so many ticks, as shares of the largest one."""


def pattern_ms(name, ticks, largest_ms, arm):
    """Delays of a pattern up to the largest one, in whole physics steps."""
    steps = int(largest_ms / STEP_MS)
    return in_order([STEP_MS * round(share * steps) for share in PATTERNS[name](ticks)], arm)


def in_order(delays_ms, arm):
    """Delays of each message in a period; one that would overtake another waits for it."""
    ticks = len(delays_ms)
    sent_ms = arm.period_ms * np.arange(3 * ticks)
    arrivals = np.maximum.accumulate(sent_ms + np.tile(delays_ms, 3))
    return (arrivals - sent_ms)[-ticks:].tolist()


@pytest.mark.parametrize("name", ARMS)
def test_no_pattern_below_the_bound_is_unstable(name, tmp_path):
    arm, bound_ms = ARMS[name], theory_ms(name, tmp_path)["any_pattern_ms"]
    for pattern in PATTERNS:
        for ticks in (2, 3, 5, 8, 13, 21, 34):
            delays = pattern_ms(pattern, ticks, bound_ms, arm)
            assert max(delays) <= bound_ms
            assert arm.loop.is_stable([1e-3 * delay for delay in delays]), (pattern, ticks)


@pytest.mark.parametrize("pattern", PATTERNS)
@pytest.mark.parametrize("name", ["PD", "PID, 250 Hz"])
def test_arm_is_kept_under_patterns_below_the_bound(name, pattern, tmp_path):
    arm, bound_ms = ARMS[name], theory_ms(name, tmp_path)["any_pattern_ms"]
    for ticks in (3, 20):
        delays = pattern_ms(pattern, ticks, bound_ms, arm)
        assert is_kept(tmp_path / "linear.yaml", varying(delays, arm, tmp_path)), ticks


@pytest.mark.parametrize(
    ("name", "largest_ms", "ticks", "late"), [("PID", 8.5, 17, 9), (UR10E, 13.5, 14, 8)]
)
def test_a_pattern_between_bound_and_margin_is_unstable(name, largest_ms, ticks, late, tmp_path):
    arm = ARMS[name]
    delays = in_order([largest_ms] * late + [0.0] * (ticks - late), arm)
    assert theory_ms(name, tmp_path)["any_pattern_ms"] < largest_ms < exact_ms(name)
    assert arm.loop.growth_per_s([1e-3 * delay for delay in delays]) > 1.0
    file = tmp_path / "linear.yaml"
    assert is_kept(file, constant(largest_ms))
    assert not is_kept(file, varying(delays, arm, tmp_path))


@pytest.mark.parametrize("seeds", [range(40), range(40, 80)])
def test_bound_is_no_more_than_the_first_unstable_delay(seeds):
    compared = 0
    for seed in seeds:
        loop, _ = random_loop(seed)
        windows = unstable_windows(loop, 60 * loop.period_s)
        if windows and windows[0].begin_s > 0.0:
            assert pattern_bound_s(loop) <= windows[0].begin_s, seed
            compared += 1
    assert compared > 16


def inertia_under_pd(proportional, derivative, period_s):
    dynamics, inputs = np.array([[0.0, 1.0], [0.0, 0.0]]), np.array([[0.0], [1.0]])
    plant = LinearPlant(dynamics, inputs, np.eye(2), np.eye(1))
    return SampledLoop(
        plant, LinearLaw(-np.array([[[proportional, derivative]]]), np.zeros(0)), period_s
    )


def continuous_bound_s(proportional, derivative, omega):
    """1 / sup |ω T(jω)| of an inertia of 1."""
    open_loop = (derivative * 1j * omega + proportional) / (1j * omega) ** 2
    return 1.0 / (omega * abs(open_loop / (1.0 + open_loop))).max()


def test_bound_of_a_fast_loop_is_that_of_continuous_time():
    expected_s = continuous_bound_s(1600.0, 60.0, np.logspace(0.0, 4.0, 20_000))
    found_s = pattern_bound_s(inertia_under_pd(1600.0, 60.0, 1e-5))
    assert found_s == pytest.approx(expected_s, rel=1e-3)


@pytest.mark.parametrize("ratio", [1e-1, 1e-2, 1e-3, 1e-4])
def test_bound_of_a_lightly_damped_loop_is_found_at_its_resonance(ratio):
    gains = 40.0**2, 2.0 * ratio * 40.0
    omega = 40.0 * (1.0 + ratio * np.linspace(-20.0, 20.0, 200_001)[1:-1])
    expected_s = continuous_bound_s(*gains, omega[omega > 0.0])
    period_s = 1e-2 * expected_s
    found_s = pattern_bound_s(inertia_under_pd(*gains, period_s))
    # The sampling itself costs half a period of the margin that damping gives.
    assert found_s == pytest.approx(expected_s - 0.5 * period_s, rel=1e-2)


# After a public report on delay margins: JuliaControl/RobustAndOptimalControl.jl, pull request 152.
LIGHT = 22.6, 0.0303  # per unit of inertia: a damping ratio of 0.003
LEFT_MS = 1e3 * LIGHT[1] / LIGHT[0] - 0.5
"""Damping over stiffness, less half a period of the hold: a delay that takes away all damping."""


def test_a_lightly_damped_joint_has_no_larger_bound_than_constant_margin(tmp_path):
    file = Arm([1.0], [LIGHT[0]], [LIGHT[1]], [0.0]).write(tmp_path)
    found = theory_of(load_setup(str(file)))
    assert found["constant_ms"] == pytest.approx(LEFT_MS, abs=0.01)
    # Kao and Lincoln: below a period, the square root of its share counts.
    assert found["any_pattern_ms"] == pytest.approx(LEFT_MS**2, abs=0.02)


def test_a_lightly_damped_arm_has_no_larger_bound_than_constant_margin(import_folder):
    wanted = f"-{LIGHT[0]} * tracking.error - {LIGHT[1]} * tracking.error_rate"
    does = f"return self.model.inverse_dynamics(tracking.position, tracking.velocity, {wanted})"
    law = own_law(import_folder, does, "little_damping")
    overrides = [
        f"controller.law={law}", "controller.model_scale=1", "rate_hz=1000",
        "controller.delay_compensation.enabled=false", "plant.friction.enabled=false",
    ]  # fmt: skip
    found = theory_of(load_setup("iiwa", overrides))
    # Gravity, which the law compensates a delay later, takes or gives a little.
    assert found["constant_ms"] == pytest.approx(LEFT_MS, abs=0.1)
    assert 0.0 < found["any_pattern_ms"] <= found["constant_ms"]
