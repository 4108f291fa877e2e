"""A law in the same process cannot change what judges it, and fails in no run that counts."""

from __future__ import annotations

import numpy as np

from deploy.judge.metrics import summarise
from deploy.run.replay import replay
from deploy.run.run_folder import load_run
from deploy.run.simulate import simulate
from deploy.scenario.scenario import load_setup
from tests.deploy.own_laws import own_law

WIDENS = """\
funnel = tracking._funnel
for bound in (funnel.initial_upper_rad, funnel.initial_lower_rad, funnel.final_rad):
    bound.setflags(write=True)
    bound[:] = 100.0
for values in tracking._reference._parameters:
    if isinstance(values, np.ndarray):
        values[:] = 0.0
return np.zeros(self.model.joints)"""
"""Gives no torque, and widens all bounds and references that it can reach."""
WIDENS_ALL = """\
import gc
for found in gc.get_objects():
    if type(found).__name__ == "Funnel":
        for bound in vars(found).values():
            if isinstance(bound, np.ndarray):
                bound.setflags(write=True)
                bound[:] = 100.0
return np.zeros(self.model.joints)"""
"""The same for every funnel in the process, those of plant and judge too."""
RAISES_AT_THE_END = """\
if tracking.time_s > 0.1985:
    raise ValueError("at the last tick")"""


def setup_of(folder, does, *changes):
    law = own_law(folder, does)
    return load_setup("paper_arm", [f"controller.law={law}", "duration_s=0.2", *changes])


def test_a_law_that_widens_its_funnel_is_judged_by_the_scenarios(import_folder):
    setup = setup_of(import_folder, WIDENS, "duration_s=1")
    narrow = setup.funnel.final_rad.copy()
    simulation = simulate(setup)
    simulation.write_log(import_folder / "run.mcap")
    np.testing.assert_array_equal(setup.funnel.final_rad, narrow)
    data, contents = load_run(import_folder / "run.mcap")
    found = [summarise(run) for run in (simulation.data(), data)]
    assert [summary["verdict"] for summary in found] == ["lost", "lost"]
    assert found[0]["bounds"] == found[1]["bounds"]
    assert replay(setup, contents).is_identical


def test_law_that_widens_all_funnels_of_its_process_is_lost_and_its_run_damaged(import_folder):
    setup = setup_of(import_folder, WIDENS_ALL, "duration_s=1")
    summary = summarise(simulate(setup).data())
    assert summary["verdict"] == "lost"
    assert summary["bounds"]["violation_fraction"] > 0.5
    assert "but the plant counted 0 of 1001" in summary["recording"]["damage"][0]


def test_a_run_whose_law_raises_at_its_last_tick_is_not_completed(import_folder):
    setup = setup_of(import_folder, RAISES_AT_THE_END, "metrics.from_s=0.1")
    summary = summarise(simulate(setup).data())
    assert "at the last tick" in summary["faults"][0]
    assert summary["ticks"] == 200
    assert (summary["completed"], summary["verdict"]) == (False, "faulted")
