"""Laws of all kinds as linear ones: theory agrees with eigenvalues of the whole loop."""

from __future__ import annotations

import numpy as np
import pytest

from deploy.scenario.scenario import load_setup
from deploy.study.theory.theory import theory_of
from tests.deploy.own_laws import own_law
from tests.deploy.study.theory.lifted_loops import LiftedLoop
from tests.deploy.study.theory.linear_arms import ARMS, Arm, constant, is_kept
from tests.warm_process import ROOT

PAGE = ROOT / "deploy" / "docs" / "explanation" / "theory.md"
K, D = 2500.0, 100.0
ARM = Arm([1.0], [K], [D], [0.0])
"""A joint of unit inertia."""
LATE = 11
PAST = f"""self.rates = [*(self.rates if self.calls > 1 else []), tracking.error_rate.copy()]
late = self.rates[-{LATE + 1}] if len(self.rates) > {LATE} else 0.0
return -{K} * tracking.error - {D / 2} * tracking.error_rate - {D / 2} * late"""
FILTER = f"""self.rate = tracking.error_rate * 0.2 + (0.8 * self.rate if self.calls > 1 else 0.0)
return -{K} * tracking.error - {D} * self.rate"""
DIFFERENCE = f"""before = self.before if self.calls > 1 else tracking.position.copy()
self.before = tracking.position.copy()
return -{K} * tracking.error - {D} * (tracking.position - before) / 0.001"""


def shift(length):
    """A register of so many values."""
    return np.eye(length, k=-1), np.eye(length, 1)


def matrices(name):
    """The laws as s' = a s + b y, u = c s + d y, with y = (position, velocity)."""
    none = np.zeros((0, 0)), np.zeros((0, 2)), np.zeros((1, 0))
    if name == "half of the damping from a rate of before":
        a, first = shift(LATE)
        b = first @ np.array([[0.0, 1.0]])
        return a, b, -0.5 * D * np.eye(1, LATE, LATE - 1), -np.array([[K, 0.5 * D]])
    if name == "a filtered rate":
        one = np.ones((1, 1))
        return 0.8 * one, np.array([[0.0, 0.16]]), -D * one, -np.array([[K, 0.2 * D]])
    if name == "differences of the position":
        slope = D / 1e-3
        return (
            np.zeros((1, 1)),
            np.array([[1.0, 0.0]]),
            slope * np.ones((1, 1)),
            -np.array([[K + slope, 0.0]]),
        )
    return *none, -np.array([[K, D]])


LAWS = {
    "errors": (f"return -{K} * tracking.error - {D} * tracking.error_rate", 12.45),
    "the measured velocity": (f"return -{K} * tracking.error - {D} * tracking.velocity", 12.45),
    "half and half": (
        f"return -{K} * tracking.error - {D / 2} * (tracking.error_rate + tracking.velocity)",
        12.45,
    ),
    "the reference by itself": (
        f"wanted = {K} * tracking.reference_position + {D} * tracking.reference_velocity\n"
        f"return wanted - {K} * tracking.position - {D} * tracking.motion[1]",
        12.45,
    ),
    "half of the damping from a rate of before": (PAST, 7.5),
    "a filtered rate": (FILTER, None),
    "differences of the position": (DIFFERENCE, None),
}


SHIPPED = [
    ("pid_gravity", 10.0, 10.5),
    ("computed_torque", 11.0, 11.5),
    ("funnel_control", 12.0, 12.5),
    ("disturbance_observer", 2.0, 2.5),
    ("time_delay_control", 2.5, 3.0),
]
"""With derived gains: the largest round trip that is kept, and the next, in ms."""


@pytest.mark.parametrize("name", LAWS)
def test_a_law_is_known_by_whatever_it_reads(name, tmp_path, import_folder):
    does, known_ms = LAWS[name]
    law = own_law(import_folder, does, f"linear_{list(LAWS).index(name)}")
    file = ARM.write(tmp_path)
    found = theory_of(load_setup(str(file), [f"controller.law={law}"]))
    loop = LiftedLoop((ARM.loop.dynamics, ARM.loop.inputs, np.eye(2)), matrices(name), 1e-3)
    margin_ms = found["constant_ms"]
    assert loop.is_stable(1e-3 * margin_ms)
    assert not loop.is_stable(1e-3 * (margin_ms + 0.02))
    assert all(loop.is_stable(1e-3 * delay) for delay in np.arange(0.0, margin_ms, 0.1))
    if known_ms is not None:
        assert margin_ms == pytest.approx(known_ms, abs=0.05)


def test_runs_of_a_law_that_uses_the_past_agree(tmp_path, import_folder):
    law = own_law(import_folder, PAST, "past")
    file = ARM.write(tmp_path)
    for delay_ms, kept in ((7.5, True), (8.0, False)):
        assert is_kept(file, [f"controller.law={law}", *constant(delay_ms)]) is kept


@pytest.mark.parametrize(("law", "kept_ms", "lost_ms"), SHIPPED)
def test_runs_of_shipped_laws_agree_with_their_theory(law, kept_ms, lost_ms, tmp_path):
    file, overrides = ARM.write(tmp_path), [f"controller.law={law}"]
    found = theory_of(load_setup(str(file), overrides))
    assert kept_ms < found["constant_ms"] < lost_ms
    row = f"| `{law}` | {found['constant_ms']:.2f} ms | {kept_ms:g} ms | {lost_ms:g} ms |"
    assert row in PAGE.read_text()
    assert is_kept(file, [*overrides, *constant(kept_ms)])
    assert not is_kept(file, [*overrides, *constant(lost_ms)])


GROWING = """self.gain = 0.999 * self.gain if self.calls > 1 else 1.0
return -self.gain * tracking.error - tracking.error_rate"""
SQUARES = """self.sum = self.sum + np.sin(self.calls) * tracking.error if self.calls > 1 else 0.0
return -self.sum - tracking.error"""
CHIRP = """self.at = self.calls if np.any(tracking.error) else getattr(self, "at", -1)
self.size = np.max(np.abs(tracking.error)) or (self.size if self.calls > 1 else 0.0)
sign = np.sign(tracking.error[0]) or (self.sign if self.calls > 1 else 1.0)
self.sign = sign
return -tracking.error - tracking.error_rate - sign * self.size * np.sin(1e-3 * self.calls**2)"""
LONG = """self.all = [*(self.all if self.calls > 1 else []), tracking.error.copy()]
return -sum(self.all[-510:]) - 10.0 * tracking.error_rate"""
REASONS = {
    "return np.zeros(2)": "does not depend on errors",
    "return -np.sign(tracking.error)": "no slope",
    "return -np.abs(tracking.error) - tracking.error_rate": "no slope",
    "return -tracking.error - 0.01 * np.abs(tracking.error_rate)": "no slope",
    "return -np.sqrt(np.abs(tracking.error)) * np.sign(tracking.error)": "no slope",
    GROWING: "depend on when it is asked",
    SQUARES: "depend on when it is asked",
    CHIRP: "not ended after 1 s: it filters or learns",
    LONG: "errors of 509 ticks before: it filters",
    "raise ValueError('broken')": "the law raised ValueError: broken",
}


@pytest.mark.parametrize("does", REASONS)
def test_a_law_without_linear_loop_has_a_reason(does, tmp_path, import_folder):
    law = own_law(import_folder, does, f"law_{list(REASONS).index(does)}")
    file = ARMS["PD, two joints with parallel axes"].write(tmp_path)
    found = theory_of(load_setup(str(file), [f"controller.law={law}"]))
    assert REASONS[does] in found["reason"]
    assert set(found) == {"reason"}


def test_own_law_that_is_linear_has_the_margins_of_the_shipped_one(tmp_path, import_folder):
    arm = ARMS["PD, two joints with parallel axes"]
    does = (
        f"return -np.array({arm.proportional}) * tracking.error"
        f" - np.array({arm.derivative}) * tracking.error_rate"
    )
    law = own_law(import_folder, does, "linear_law")
    file = arm.write(tmp_path)
    own, shipped = (theory_of(load_setup(str(file), o)) for o in ([f"controller.law={law}"], []))
    assert own == shipped
    assert own["joint"] == "j1"


@pytest.mark.parametrize(
    ("overrides", "reason"),
    [
        (["controller.delay_compensation.enabled=true"], "compensation"),
        (["controller.every=2"], "slower"),
        (["controller.inference_ms=2"], "slower"),
    ],
)
def test_a_scenario_beyond_the_linear_loop_has_a_reason(overrides, reason, tmp_path):
    file = ARM.write(tmp_path)
    assert reason in theory_of(load_setup(str(file), overrides))["reason"]


def test_a_law_whose_targets_close_the_loops_of_drives_has_a_reason(tmp_path, import_folder):
    own_law(import_folder, "return -tracking.error", "with_targets")
    module = import_folder / "with_targets.py"
    target = "    def target(self, tracking):\n        return tracking.motion\n"
    module.write_text(module.read_text() + "\n" + target)
    file = ARM.write(tmp_path)
    overrides = ["controller.law=with_targets:Own", "controller.drive_feedback.enabled=true"]
    found = theory_of(load_setup(str(file), overrides))
    assert found == {"reason": "the drives follow the law's own targets"}
