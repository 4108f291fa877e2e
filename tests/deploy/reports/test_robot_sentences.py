"""Sentences on the lag of a robot that takes positions or velocities, in whole runs."""

import re

from deploy.judge.metrics import RunResult, summarise
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
