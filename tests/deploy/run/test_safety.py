"""Failing loops and limits in whole simulations: how the arm is stopped, and what is left of it."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

from bus_schema.messages.run_event import EventKind
from bus_schema.messages.topics import JOINT_COMMANDS, JOINT_STATES, PLANT_TRUTH, RUN_EVENTS, Role
from bus_schema.runtime.modes import Mode, mode_in
from deploy.judge.metrics import summarise
from deploy.reports.results import write_run
from deploy.run.execute import JudgedRun
from deploy.run.new_folder import new_folder
from deploy.run.replay import replay
from deploy.run.run_folder import RunFolder, load_run
from deploy.run.simulate import simulate
from deploy.scenario.scenario import load_setup
from tests.deploy.own_laws import own_law


def failing_run(folder, outcome, *overrides):
    law = ["controller.gains.custom={at_tick: 200}", "duration_s=1", *overrides]
    law.append(f"controller.law={own_law(folder, f'return {outcome}')}")
    return simulate(load_setup("paper_arm", law))


def modes(run, role):
    reported = (e for e in run.events if e.source == role and e.kind == EventKind.MODE)
    return [(mode_in(event.detail), event.stamp_ns) for event in reported]


@pytest.mark.parametrize("outcome", ["np.full(3, np.nan)", "1 / 0"])
def test_law_that_fails_stops_both_sides(import_folder, outcome):
    simulation = failing_run(import_folder, outcome, "plant.command_timeout_ms=100")
    run = simulation.data()
    assert simulation.failure is not None
    ms = 1_000_000
    assert modes(run, Role.CONTROLLER) == [
        (Mode.READY, 0), (Mode.TRACKING, 0), (Mode.STOPPING, 200 * ms), (Mode.FAULT, 200 * ms),
    ]  # fmt: skip
    assert run.tables[JOINT_COMMANDS.name]["effort"][-1].tolist() == [0.0, 0.0, 0.0]
    plant = modes(run, Role.PLANT)
    assert [mode for mode, _ in plant] == [Mode.READY, Mode.TRACKING, Mode.STOPPING, Mode.FAULT]
    # The last command took effect at 200 ms; the arm stops a timeout and a tick later at most.
    assert 300 * ms <= plant[2][1] <= 302 * ms
    faults = [event.source for event in run.events if event.kind == EventKind.FAULT]
    assert faults[0] == Role.CONTROLLER
    assert not summarise(run)["completed"]


def test_run_that_faulted_replays_bit_for_bit_and_has_its_fault_record(import_folder):
    folder = RunFolder(new_folder("failing", import_folder / "run"))
    failing_run(import_folder, "np.full(3, np.nan)").write_log(folder.log)
    run, contents = load_run(folder.path)
    assert replay(run.setup, contents).is_identical
    write_run(folder, JudgedRun("", run))
    record = json.loads(folder.fault.read_text())
    assert (record["source"], record["at_s"]) == ("controller", 0.2)
    assert "returned the torque [nan, nan, nan] at tick 200" in record["detail"]
    states, commands = record["states"], record["commands"]
    assert len(states) == len(commands) == 100
    assert states[-1]["stamp_s"] == commands[-1]["stamp_s"] == 0.2
    position = run.tables[JOINT_STATES.name]["position"][200]
    assert states[-1]["position"] == position.tolist()
    assert commands[-1]["effort"] == [0.0, 0.0, 0.0]
    assert commands[-2]["effort"] != [0.0, 0.0, 0.0]


@pytest.mark.parametrize("was_answered", [False, True])
def test_a_run_that_ended_before_its_last_answer_replays_as_far_as_it_was_answered(
    tmp_path, was_answered
):
    """A recording that lacks the last command: fine unless the controller counts it as sent."""
    folder = RunFolder(new_folder("interrupted", tmp_path / "run"))
    simulate(load_setup("paper_arm", ["duration_s=0.05"])).write_log(folder.log)
    run, contents = load_run(folder.path)
    contents.payloads[JOINT_COMMANDS.name].pop()
    if not was_answered:
        contents.payloads[RUN_EVENTS.name] = [
            replace(event, detail=json.dumps({**counts, "cycles": counts["cycles"] - 1})).encode()
            if (event.source, event.kind) == (Role.CONTROLLER, EventKind.ENDED)
            and (counts := event.values())
            else event.encode()
            for event in run.events
        ]
    assert replay(run.setup, contents).is_identical != was_answered


def test_failing_physics_stops_the_arm():
    setup = load_setup("paper_arm", ["duration_s=0.5"])

    def sabotage(plant):
        advance = plant._arm.advance

        def fail(first, end):
            if setup.grid.substep_ns(end) > 100_000_000:
                raise OSError("the bench is on fire")
            advance(first, end)

        plant._arm.advance = fail

    run = simulate(setup, sabotage).data()
    expected = [Mode.READY, Mode.TRACKING, Mode.STOPPING, Mode.FAULT]
    assert [mode for mode, _ in modes(run, Role.PLANT)] == expected
    (fault,) = [event for event in run.events if event.kind == EventKind.FAULT]
    assert "OSError: the bench is on fire" in fault.detail


def test_limits_that_were_met_are_counted_on_both_sides():
    tight = ["limits.torque_nm=[20, 400, 60]", "limits.velocity_rad_s=0.2", "duration_s=0.5"]
    run = simulate(load_setup("paper_arm", tight)).data()
    limits = summarise(run)["limits"]
    assert limits["controller"]["torque"] > 0
    assert limits["plant"]["torque"] == 0  # the controller let nothing through
    fast = np.abs(run.tables[PLANT_TRUTH.name]["velocity"]) > 0.2
    assert limits["plant"]["velocity"] == pytest.approx(fast.any(axis=1).sum(), abs=5)
    reported = [(e.source, e.detail) for e in run.events if e.kind == EventKind.LIMIT]
    assert ("plant", "reached for the first time: velocity") in reported
    assert (np.abs(run.tables[JOINT_COMMANDS.name]["effort"]) <= [20.0, 400.0, 60.0]).all()


def test_too_fast_an_arm_is_stopped_where_that_is_asked_for():
    stop = ["limits.velocity_rad_s=0.2", "limits.on_velocity=stop", "duration_s=0.5"]
    run = simulate(load_setup("paper_arm", stop)).data()
    summary = summarise(run)
    assert not summary["completed"]
    assert "beyond its limits: velocity: safe stop (brake)" in summary["faults"][0]
    truth = run.tables[PLANT_TRUTH.name]
    first = int(np.argmax((np.abs(truth["velocity"]) > 0.2).any(axis=1)))
    stopped = int(np.argmax(truth["mode"] == Mode.STOPPING))
    assert first <= stopped <= first + 2


def test_plant_limits_the_change_of_torques_itself():
    rate = 5000.0
    run = simulate(
        load_setup("paper_arm", [f"limits.torque_rate_nm_s={rate}", "duration_s=0.3"])
    ).data()
    torque = run.tables[PLANT_TRUTH.name]["torque"]
    assert np.abs(np.diff(torque, axis=0)).max() <= rate * 1e-3 * (1 + 1e-9)
    assert summarise(run)["limits"]["plant"]["torque_rate"] > 0
