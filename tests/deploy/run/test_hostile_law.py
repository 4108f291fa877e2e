"""A law in the same process cannot change what judges it, and fails in no run that counts."""

from __future__ import annotations

import json

import numpy as np
import pytest

from deploy.judge.metrics import summarise
from deploy.run.new_folder import FolderLock
from deploy.run.replay import replay
from deploy.run.run_folder import load_run
from deploy.run.simulate import simulate
from deploy.scenario.scenario import load_setup
from tests.deploy.own_laws import own_law
from tests.warm_process import WITHOUT_REPORT, WarmProcess

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
for found in gc.get_objects() if tracking.time_s < 0.0025 else ():
    if type(found).__name__ == "Funnel":
        for bound in vars(found).values():
            if isinstance(bound, np.ndarray):
                bound.setflags(write=True)
                bound[:] = 100.0
return np.zeros(self.model.joints)"""
"""The same for every funnel in the process, those of plant and judge too; it looks in few ticks."""
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


JUDGES_ITSELF = """\
import deploy.judge.metrics
from deploy.judge.verdict import Verdict
deploy.judge.metrics.decide = lambda *_, **__: Verdict.KEPT
return np.zeros(self.model.joints)"""
JUDGES_FROM_A_THREAD = """\
import deploy.judge.metrics
import threading
from deploy.judge.verdict import Verdict
def judge():
    while True:
        deploy.judge.metrics.decide = lambda *_, **__: Verdict.KEPT
if self.calls == 1:
    threading.Thread(target=judge, daemon=True).start()
return np.zeros(self.model.joints)"""
REWRITES_THE_SUMMARY = """\
import atexit, json
from pathlib import Path
def rewrite():
    summary = json.loads(Path("run/summary.json").read_text())
    Path("run/summary.json").write_text(json.dumps({**summary, "verdict": "kept"}))
if self.calls == 1:
    atexit.register(rewrite)
return np.zeros(self.model.joints)"""
REWRITES_IT_LATER = """\
import os, time
from pathlib import Path
if self.calls == 1 and os.fork() == 0:
    while not Path("run/summary.json").exists():
        time.sleep(0.001)
    Path("run/summary.json").write_text('{"verdict": "kept"}')
    os._exit(0)
return np.zeros(self.model.joints)"""
LEAVES_A_PROCESS = """\
import os, sys
if self.calls == 50 and os.fork() == 0:
    sys.exit()"""
FALLS = "return np.zeros(self.model.joints)"


def simulated(folder, does, *more):
    """Return the exit code, the output and the summary of the command `simulate`."""
    law = f"controller.law={own_law(folder, does)}"
    words = ["simulate", "--set", law, "--set", "duration_s=1", "--out", folder / "run", *more]
    command = WarmProcess(*words, main=WITHOUT_REPORT, cwd=folder)
    output, _ = command.communicate()
    file = folder / "run" / "summary.json"
    return command.wait(), output, json.loads(file.read_text()) if file.exists() else {}


@pytest.mark.parametrize(
    "does",
    [JUDGES_ITSELF, JUDGES_FROM_A_THREAD, REWRITES_THE_SUMMARY, REWRITES_IT_LATER],
    ids=["judges", "from a thread", "rewrites at exit", "rewrites later"],
)
def test_law_cannot_change_the_verdict_of_the_command(import_folder, does):
    code, output, summary = simulated(import_folder, does, "--require-bounds")
    assert (code, summary["verdict"]) == (3, "lost"), output


def test_process_that_a_law_leaves_ends_with_the_run_and_holds_no_lock(import_folder):
    code, output, summary = simulated(import_folder, LEAVES_A_PROCESS)
    assert code == 0, output
    assert summary["completed"]
    FolderLock(import_folder / "run").close()


def test_confirmation_of_a_custom_law_runs_beside_the_judge(import_folder):
    code, output, summary = simulated(import_folder, FALLS, "--confirm", "--require-bounds")
    assert (code, summary["verdict"]) == (3, "lost"), output
    assert {each["runs"] for each in summary["confirmation"]} == {1}


def test_full_disk_ends_the_recording_of_a_simulation_and_is_named(import_folder, small_disk):
    words = ["--set", "duration_s=5", "--out", small_disk / "run"]
    command = WarmProcess("simulate", *words, main=WITHOUT_REPORT, cwd=import_folder)
    output, _ = command.communicate()
    assert command.wait() == 1
    assert "run.mcap: the recording is partial: No space left on device" in output
    summary = json.loads((small_disk / "run" / "summary.json").read_text())
    assert (summary["verdict"], summary["completed"]) == ("faulted", False)
