"""Theory of loops around a robot's own controller."""

import numpy as np
import pytest

from deploy.scenario.scenario import load_setup
from deploy.study.theory.theory import theory_of
from tests.deploy.study.theory.linear_arms import Arm

KIND = "plant.interface.kind={}"
FAST = "plant.interface.rate_hz=1000"


@pytest.fixture(scope="module")
def file(tmp_path_factory):
    return str(Arm([0.5], [1.0], [1.0], [0.0]).write(tmp_path_factory.mktemp("arm")))


def theory(file, law, kind, *words):
    return theory_of(load_setup(file, [f"controller.law={law}", KIND.format(kind), *words]))


@pytest.mark.parametrize("rate_hz", [1000, 500])
@pytest.mark.parametrize("k_p", [5.0, 10.0])
def test_velocity_loop_has_its_closed_form(file, k_p, rate_hz):
    """π / 2 k_p, less half a period of the hold and half of the cycle that the robot needs."""
    gain = f"controller.gains.proportional_velocity.k_p={k_p}"
    words = ("proportional_velocity", "speedj", gain, f"plant.interface.rate_hz={rate_hz}")
    expected_ms = 1e3 * np.pi / (2.0 * k_p) - 1e3 / rate_hz
    assert theory(file, *words)["constant_ms"] == pytest.approx(expected_ms, abs=0.05)


def test_position_loop_has_the_margin_of_its_continuous_loop(file):
    """L(s) = k_p / (1 + s/ω_f) / (1 + s/ω)² e^(−s d): phase −π where its modulus is 1."""
    k_p, filter_rad_s, lag_s = 3.0, 40.0, 0.05
    gains = f"{{proportional: {k_p}, integral: 0, filter_rad_s: {filter_rad_s}}}"
    found = theory(
        file, "position_correction", "servoj", FAST,
        f"controller.gains.position_correction={gains}",
        "plant.interface.servoj.dead_time_ms=6", f"plant.interface.servoj.lag_ms={1e3 * lag_s}",
    )  # fmt: skip
    frequency = np.linspace(1.0, 400.0, 400_000)
    s = 1j * frequency
    open_loop = k_p / (1.0 + s / filter_rad_s) / (1.0 + 0.5 * lag_s * s) ** 2
    at = np.flatnonzero(np.abs(open_loop) >= 1.0)[-1]
    left = np.pi + np.unwrap(np.angle(open_loop))[at]
    expected_ms = 1e3 * left / frequency[at] - 6.0 - 0.5  # dead time, and half a period of hold
    assert found["constant_ms"] == pytest.approx(expected_ms, abs=0.6)


@pytest.mark.parametrize(
    ("law", "kind", "words"),
    [("pid", "servoj", "closes its loops"), ("streaming", "egm", "closes its loops"),
     ("streaming", "servoj", "does not depend on errors"),
     ("pid", "franka_torque", "reads torques at its own rate")],
)  # fmt: skip
def test_theory_says_why_there_is_none(file, law, kind, words):
    assert words in theory(file, law, kind)["reason"]
