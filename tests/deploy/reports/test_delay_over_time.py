"""The figure of how late commands were, with the one in force when bounds were left."""

from __future__ import annotations

import numpy as np

from deploy.reports.figures.link import delay_over_time
from deploy.run.execute import JudgedRun
from deploy.run.simulate import simulate
from deploy.scenario.scenario import load_setup
from deploy.study.comparison.compared_runs import ComparedRuns


def drawn(*settings):
    setup = load_setup("paper_arm", ["duration_s=0.4", "metrics.from_s=0.2", *settings])
    run = JudgedRun("", simulate(setup).data())
    return run, delay_over_time(ComparedRuns([run]))


def test_nothing_is_drawn_of_a_delay_that_never_changes():
    for delay_ms, is_kept in ((2, True), (60, False)):
        run, figure = drawn(f"link.uplink.delay_ms={delay_ms}")
        assert run.summary["bounds"]["kept"] is is_kept
        assert figure is None


def test_the_command_in_force_at_the_loss_is_marked_with_its_delay():
    # A square wave between 0 and 90 ms, of 100 ms: far more than this law stands.
    pattern = "link.uplink.pattern={shape: square, period_ms: 100}"
    run, figure = drawn("controller.law=smc", "link.uplink.delay_ms=90", pattern)
    lost_s = run.summary["bounds"]["first_violation_s"]
    assert lost_s is not None
    line, cross = figure.data
    assert np.max(line.y) >= 50.0
    assert cross.x == (lost_s,)
    before = np.flatnonzero(np.asarray(line.x) <= lost_s)[-1]
    assert cross.y[0] == line.y[before]
