"""Runs with the dead time of actuators are those with as much delay of the downlink."""

import numpy as np
import pytest

from deploy.run.execute import execute
from deploy.scenario.scenario import load_setup
from deploy.study.theory.theory import theory_of
from tests.arms import needs_bullet

ACTUATOR, DOWNLINK = "plant.actuator.delay_ms={}", "link.downlink.delay_ms={}"
COMPENSATED = (
    "controller.law=fixed_time_adaptive", "controller.delay_compensation.enabled=true",
    "plant.physics.engine=mujoco",
)  # fmt: skip


def run(*words):
    return execute(load_setup("paper_arm", ["duration_s=1.2", "metrics.from_s=0.6", *words]))


@pytest.mark.parametrize("engine", ["mujoco", pytest.param("bullet", marks=needs_bullet)])
def test_states_and_commands_are_the_same_bits(engine):
    words = ("controller.law=pid", f"plant.physics.engine={engine}", "link.uplink.delay_ms=1")
    delayed, late = run(*words, DOWNLINK.format(6.25)), run(*words, ACTUATOR.format(6.25))
    assert delayed.summary["digest"] == late.summary["digest"]
    assert delayed.summary["digest"] != run(*words).summary["digest"]


@pytest.mark.parametrize(
    "more", [(), ("link.playout_ms=0",), ("controller.drive_feedback.enabled=true",),
             ("link.uplink.delay_ms=10", "link.downlink.delay_ms=4")]
)  # fmt: skip
def test_compensation_knows_the_dead_time(more):
    """It tracks as over a link of the same delay; without it, this delay loses the arm."""
    link = 4 if any("downlink" in each for each in more) else 0
    late = run(*COMPENSATED, *more, ACTUATOR.format(20))
    delayed = run(*COMPENSATED, *more, DOWNLINK.format(20 + link))
    assert late.summary["verdict"] == "kept"
    found, wanted = (np.array(each.summary["tracking"]["rms_rad"]) for each in (late, delayed))
    np.testing.assert_allclose(found, wanted, rtol=0.2)
    bare = run(COMPENSATED[0], COMPENSATED[2], ACTUATOR.format(20))
    assert bare.summary["verdict"] == "lost"


def test_theory_takes_the_dead_time_from_both_margins():
    words = ["controller.law=pid", "plant.friction.enabled=false"]
    without, late = (
        theory_of(load_setup("paper_arm", [*words, ACTUATOR.format(ms)])) for ms in (0, 5)
    )
    for key in ("constant_ms", "any_pattern_ms"):
        assert late[key] == pytest.approx(max(without[key] - 5.0, 0.0), abs=0.02)
    assert (
        "dead time" in theory_of(load_setup("paper_arm", [*words, ACTUATOR.format(900)]))["reason"]
    )
