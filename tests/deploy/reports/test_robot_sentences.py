"""Sentences on the lag of a robot that takes positions or velocities, in whole runs."""

import re

import numpy as np
import pytest

from bus_schema.messages import topics
from controller.control_law import Diagnostics
from deploy.judge.metrics import RunResult, judge, summarise
from deploy.judge.motion.tip_error import tips_apart_m
from deploy.reports.verdict_texts import verdict_on_run
from deploy.run.execute import JudgedRun
from deploy.run.simulate import simulate
from deploy.scenario.scenario import load_setup

SERVOJ = ("plant.interface.kind=servoj", "controller.law=streaming")


def judged(*words):
    """A run of the three-joint arm, its result and its sentences."""
    data = simulate(load_setup("paper_arm", words)).data()
    result = RunResult(**summarise(data))
    return data, result, " ".join(verdict_on_run(JudgedRun("run", data, result)).reasons)


def test_lags_end_where_the_robot_stops():
    """The outage stops it at 3.2 s; until then it makes commands 17 ms older on average."""
    outage = "link.uplink.schedule=[{kind: outage, at_s: 3, for_s: 0.5}]"
    _, stopped, said = judged(*SERVOJ, "duration_s=4", outage)
    _, until, _ = judged(*SERVOJ, "duration_s=3.199", outage, "metrics.from_s=2")
    assert re.search(r"joints would be 15\d ms behind", said)
    for name in ("own_ms", "preview_ms", "without_preview_ms", "tip_rms_mm"):
        found, wanted = getattr(stopped.robot_lag, name), getattr(until.robot_lag, name)
        assert abs(found - wanted) <= 0.02 * wanted
    assert all(
        abs(found - wanted) <= 1.0
        for found, wanted in zip(stopped.lag_ms, until.lag_ms, strict=True)
    )


def test_a_robot_that_no_command_moves_has_no_lag():
    _, result, said = judged(*SERVOJ, "duration_s=1", "link.uplink.loss=1")
    assert result.lag_ms == 3 * [None]
    assert result.robot_lag.without_preview_ms is result.robot_lag.late_ms is None
    assert result.robot_lag.tip_rms_mm is None
    assert "their reference by" not in said
    assert "joints would" not in said


def mean_age_ms(data):
    """Mean age of the commands in force from 2 s on."""
    truth = data.tables[topics.PLANT_TRUTH.name]
    return 1e-6 * truth["command_age_ns"][data.times_s(topics.PLANT_TRUTH) >= 2.0].mean()


@pytest.mark.parametrize("delay", [(), ("link.downlink.delay_ms=2.4",)])
@pytest.mark.parametrize(
    "losses", [("link.uplink.loss=0.3", "link.downlink.loss=0.3"), ("link.uplink.loss=0.8",)]
)
def test_the_cost_of_frequent_losses_is_that_beyond_a_run_without(losses, delay):
    words = (*SERVOJ, "duration_s=4", "metrics.from_s=2", *delay)
    data, result, said = judged(*words, *losses)
    wanted_ms = mean_age_ms(data) - mean_age_ms(simulate(load_setup("paper_arm", words)).data())
    assert wanted_ms > 0.9
    assert result.robot_lag.late_ms == pytest.approx(wanted_ms, rel=0.1)
    assert "older on average than without losses, about" in said


@pytest.mark.parametrize("kind", ["servoj", "egm"])
def test_the_part_of_an_outage_in_the_tip_error_is_not_that_of_its_mean(kind):
    """150 ms without commands in 7 s are 1.6 ms on average, whose error is a seventh."""
    words = (f"plant.interface.kind={kind}", "controller.law=streaming", "duration_s=8",
             "metrics.from_s=1", "robot.initial_offset_rad=0")  # fmt: skip
    outage = "link.downlink.schedule=[{kind: outage, at_s: 3, for_s: 0.15}]"
    whole, late = (
        simulate(load_setup("ur5e_motors", [*words, *more])).data() for more in ((), (outage,))
    )
    apart_m = tips_apart_m(
        late.setup.robot, *(each.tables["plant_truth"]["position"][1000:] for each in (whole, late))
    )
    true_mm = 1e3 * np.sqrt((apart_m**2).mean())
    found_mm = judge(late).robot_lag.late_tip_rms_mm
    assert true_mm / 1.4 < found_mm < true_mm * 1.4


def test_a_lost_run_says_how_far_the_tip_was_off_at_its_loss():
    words = (*SERVOJ, "controller.preview_ms=0", "duration_s=3", "robot.initial_offset_rad=0")
    data, result, said = judged(*words)
    tick = round(result.loss.time_s / 1e-3)
    positions = data.tables[topics.PLANT_TRUTH.name]["position"][tick]
    wanted = positions - data.true_errors_rad[tick]
    [away_m] = tips_apart_m(data.setup.robot, positions[None], wanted[None])
    at_loss = f"The tip was off by {1e3 * away_m:.3g} mm as the arm left its bounds at 0.333 s"
    assert f"{at_loss}, and by " in said


@pytest.mark.parametrize("varies", [
    ("link.uplink.jitter_ms=10", "link.uplink.delay_ms=20"),
    ("link.uplink.trace={file: wifi_campus}",),
    ("link.uplink.delay_ms=5", "link.uplink.pattern={shape: square, period_ms: 100}"),
    ("controller.every=4",),
    ("link.transport=tcp", "plant.command_timeout_ms=2000"),
])  # fmt: skip
def test_no_cost_is_named_where_the_age_without_losses_is_unknown(varies):
    _, result, said = judged(*SERVOJ, "duration_s=2", "link.downlink.loss=0.05", *varies)
    assert result.robot_lag.late_ms is result.robot_lag.late_tip_rms_mm is None
    assert "commands in force were" not in said
    assert "The same command with --set link.downlink.loss=0 shows" in said


def test_one_lost_message_is_one_message():
    words = (*SERVOJ, "duration_s=2", "metrics.from_s=0.5")
    _, _, said = judged(*words, "link.uplink.schedule=[{kind: outage, at_s: 1, for_s: 0.001}]")
    assert "With 1 message lost, commands in force were 0.00" in said
    assert "The same command with --set 'link.uplink.schedule=[]' shows" in said


class Ahead:
    """A law of targets that makes up for a share of the robot's own lag."""

    def __init__(self, model, share):
        self.diagnostics, self.share, self.lead_s = Diagnostics(model.joints), share, 0.0

    def make_up_for(self, lag_s):
        self.lead_s = self.share * lag_s

    def target(self, tracking):
        return tracking.reference_at(np.array([tracking.time_s + self.lead_s]))[0]

    def reset(self):
        pass


@pytest.mark.parametrize(("share", "is_blamed"), [(0.0, True), (0.4, True), (0.7, False)])
def test_a_lag_that_a_policy_makes_up_for_is_not_blamed(share, is_blamed):
    """Joints are behind by (1 - share) of the robot's own lag of 138 ms."""
    law = f"controller.law={__name__}:Ahead"
    words = ("plant.interface.kind=servoj", law, f"controller.gains.custom={{share: {share}}}")
    wide = (
        "funnel={convergence_margin_rad: 1, overshoot_margin_rad: 1, final_rad: 1}",
        "robot.initial_offset_rad=0",
    )
    _, result, said = judged(*words, "duration_s=3", *wide)
    assert result.loss is None
    assert "behind their reference by" in said
    for blame in ("; the robot's own lag is 138 ms", "Send each target earlier by that lag"):
        assert (blame in said) == is_blamed
    narrow = ("funnel.final_rad=0.003", "robot.initial_offset_rad=0")
    _, lost, _ = judged(*words, "duration_s=3", *narrow)
    assert lost.loss.reason == ("robot's lag" if is_blamed else "lag")
    assert (lost.loss.own_lag_ms is not None) == is_blamed


@pytest.mark.parametrize(("transport", "is_said"), [("udp", True), ("tcp", False)])
def test_losses_before_a_robot_with_a_client_over_tcp_name_that_transport(transport, is_said):
    """A dropped message costs one target, a resent one holds up all behind it."""
    link = ("link.uplink.loss=0.05", f"link.transport={transport}")
    _, _, said = judged(*SERVOJ, "duration_s=2.5", *link)
    assert ("--set link.transport=tcp" in said) is is_said
