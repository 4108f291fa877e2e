"""A loss after an injected fault is the fault's, not the law's."""

from __future__ import annotations

import pytest

from deploy.judge.findings.loss_reason import Reason, loss_reason
from deploy.reports.verdict_texts import loss_words
from deploy.run.simulate import simulate
from deploy.scenario.scenario import load_setup

STUCK = "{kind: encoder_stuck, joint: elbow, at_s: 0.1}"
BRIEF = "{kind: encoder_noisy, joint: elbow, noise_rad: 1e-9, at_s: 0.01, for_s: 0.01}"
PUSH = "plant.disturbance.terms=[{kind: step, joint: elbow, torque_nm: 2000, start_s: %s}]"


def loss_with(fault, *overrides):
    words = ["duration_s=1.6", f"faults=[{fault}]", *overrides]
    return loss_reason(simulate(load_setup("paper_arm", words)).data())


def test_a_fault_that_still_acts_is_the_reason():
    loss = loss_with(STUCK)
    assert (loss.reason, loss.frequency_hz) == (Reason.INJECTED, None)
    assert loss_words(loss) == "after the injected fault encoder_stuck, joint elbow at 0.1 s"


@pytest.mark.parametrize(("pushed_s", "is_fault"), [(0.5, True), (1.3, False)])
def test_a_fault_that_ended_more_than_a_second_before_is_not(pushed_s, is_fault):
    """More than the joint's 300 N m pushes it out of its funnel; the fault ended at 0.02 s."""
    loss = loss_with(BRIEF, PUSH % pushed_s)
    assert pushed_s < loss.time_s < pushed_s + 0.1
    assert (loss.reason == Reason.INJECTED) is is_fault
