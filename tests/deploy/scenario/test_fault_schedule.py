"""Every shipped fault, in virtual time: what it does to the arm, to the messages and to the run.

Expected numbers: the run is 2 s at 1 kHz, faults begin at 1 s, the command timeout is 200 ms and
the arm is watched for 0.5 s after a safe stop.
"""

import re
from functools import cache

import numpy as np
import pytest

from bus_schema.messages import topics
from bus_schema.messages.run_event import EventKind
from bus_schema.recording.mcap_log import read_log
from bus_schema.runtime.modes import Mode
from deploy.judge.metrics import summarise
from deploy.run.replay import replay
from deploy.run.simulate import simulate
from deploy.scenario.scenario import load_setup
from deploy.scenario.yaml_files import ScenarioError
from scripts.experiments.fault_table import (
    BEGIN,
    END,
    PAGE,
    fault_scenarios,
    measure,
    needs_processes,
    to_safe_state_ms,
)

SIMULATED = [name for name in fault_scenarios() if not needs_processes(load_setup(name))]
FAULT_TICK, TIMEOUT_MS = 1000, 200.0
measured = cache(measure)


@cache
def healthy():
    return simulate(load_setup("paper_arm", ["duration_s=2"]))


# What becomes of the run: exit code, and whether the arm is stopped.
RIDES_THROUGH = {
    "actuator_dead", "actuator_weak", "clock_drift", "downlink_duplicated", "encoder_biased",
    "encoder_noisy", "encoder_stuck", "payload_dropped", "payload_picked_up", "second_commander",
    "torque_offset", "uplink_corrupted", "uplink_cut", "uplink_duplicated", "uplink_slowed",
}  # fmt: skip
# What the plant counts: direction, reason (or what became of it), number.
COUNTED = {
    "controller_clock_step": ("downlink", "stale", 300),
    "downlink_corrupted": ("downlink", "malformed", 300),
    "downlink_duplicated": ("downlink", "overtaken", 300),
    "non_finite_command": ("downlink", "not_finite", 300),
    "plant_clock_step": ("downlink", "from_the_future", 300),
    "uplink_duplicated": ("downlink", "stale", 300),
}


@pytest.mark.parametrize("name", SIMULATED)
def test_fault_has_the_outcome_stated(name):
    outcome = measured(name)
    truth = outcome.run.tables[topics.PLANT_TRUTH.name]
    limits = outcome.run.setup.robot.effort_limits_nm
    assert np.isfinite(truth["torque"]).all()
    assert (np.abs(truth["torque"]) <= limits).all()
    if name.removeprefix("faults/") in RIDES_THROUGH:
        assert (outcome.code, outcome.to_safe_state_ms) == (0, None)
        assert len(truth) == 2001
        return
    assert outcome.code == 1
    # The last torque came into force at the tick before the fault, or at that tick.
    assert TIMEOUT_MS - 2.0 <= outcome.to_safe_state_ms <= outcome.allowed_ms == TIMEOUT_MS + 2.0
    stopped = np.isin(truth["mode"], (Mode.STOPPING, Mode.FAULT))
    assert (np.diff(stopped.astype(int)) >= 0).all()  # there is no way back
    assert np.argmax(stopped) <= FAULT_TICK + TIMEOUT_MS + 2
    assert np.abs(truth["velocity"][-1]).max() < 1e-3


@pytest.mark.parametrize("name", COUNTED)
def test_what_is_kept_out_is_counted(name):
    direction, reason, count = COUNTED[name]
    summary = measured(f"faults/{name}").summary
    rejected = summary["transport"][direction]["rejected"]
    rejected.pop("after_stop", None)  # what goes on coming once the arm is stopped
    assert rejected == {reason: count}


@pytest.mark.parametrize("name", SIMULATED)
def test_fault_is_announced_and_begins_on_time(name):
    run = measured(name).run
    reported = [event for event in run.events if event.kind == EventKind.INJECTED]
    fault = run.setup.scenario.faults[0]
    assert reported[0].stamp_ns == fault.start_ns == 1_000_000_000
    assert reported[0].detail == f"{fault}: begins"
    states = run.tables[topics.JOINT_STATES.name]
    before = healthy().data().tables[topics.JOINT_STATES.name]
    if name != "faults/payload_dropped":  # its arm is heavier from the start
        assert states[:FAULT_TICK].tobytes() == before[:FAULT_TICK].tobytes()


OVER_CAN = ["link.kind=can", "link.can.interface=virtual", "rate_hz=500", "duration_s=1.5"]
ARM_FAULTS = {
    "actuator_dead", "actuator_weak", "encoder_biased", "encoder_noisy", "encoder_stuck",
    "payload_dropped", "payload_picked_up", "torque_offset",
}  # fmt: skip


@pytest.mark.parametrize("name", ["actuator_weak", "encoder_stuck", "payload_picked_up"])
def test_fault_of_the_arm_does_the_same_over_can(name):
    outcomes = []
    for overrides in (OVER_CAN, [*OVER_CAN, "link.kind=in_process"]):
        run = simulate(load_setup(f"faults/{name}", overrides)).data()
        reported = [event.stamp_ns for event in run.events if event.kind == EventKind.INJECTED]
        assert reported[0] == 1_000_000_000
        assert run.faults() == []
        assert to_safe_state_ms(run) is None
        outcomes.append(summarise(run)["bounds"])
    over_can, in_process = outcomes
    assert over_can["kept"] == in_process["kept"]
    if not over_can["kept"]:  # a tick of 2 ms, and what quantisation does to the error
        delayed_s = over_can["first_violation_s"] - in_process["first_violation_s"]
        assert abs(delayed_s) <= 0.004


@pytest.mark.parametrize(
    "name", sorted({name.removeprefix("faults/") for name in SIMULATED} - ARM_FAULTS)
)
def test_fault_of_messages_or_processes_is_refused_over_can_with_a_way_out(name):
    with pytest.raises(ScenarioError, match=r"link\.can\.faults|use run"):
        simulate(load_setup(f"faults/{name}", OVER_CAN))


def test_cut_link_loses_all_that_is_sent_meanwhile():
    uplink = measured("faults/uplink_cut").summary["transport"]["uplink"]
    assert (uplink["lost"], uplink["loss_burst"]["longest"]) == (50, 50)


def test_slowed_link_delays_by_what_it_says():
    delays = measured("faults/uplink_slowed").summary["transport"]["uplink"]["delay_ms"]
    assert (delays["p50"], delays["max"]) == (0.0, 20.0)


def test_stuck_encoder_shows_one_position_and_no_velocity():
    run = measured("faults/encoder_stuck").run
    states = run.tables[topics.JOINT_STATES.name][FAULT_TICK : FAULT_TICK + 300]
    assert len(set(states["position"][:, 2])) == 1
    assert (states["velocity"][:, 2] == 0.0).all()
    assert len(set(states["position"][:, 1])) == 300


def test_biased_encoder_is_off_by_its_bias():
    run = measured("faults/encoder_biased").run
    seen = run.tables[topics.JOINT_STATES.name]["position"][:2000, 2]
    true = run.tables[topics.PLANT_TRUTH.name]["position"][:2000, 2]
    expected = np.zeros(2000)
    expected[FAULT_TICK : FAULT_TICK + 300] = 0.005
    np.testing.assert_allclose(seen - true, expected, atol=1e-15)


def test_noisy_encoder_has_the_noise_asked_for():
    run = measured("faults/encoder_noisy").run
    states = run.tables[topics.JOINT_STATES.name]
    truth = run.tables[topics.PLANT_TRUTH.name]
    noise = (states["position"] - truth["position"][:2000])[:, 2]
    assert not noise[:FAULT_TICK].any()
    assert not noise[FAULT_TICK + 300 :].any()
    # 300 draws tell a standard deviation to 4 %; four times that is no accident.
    assert np.std(noise[FAULT_TICK : FAULT_TICK + 300]) == pytest.approx(1e-4, rel=0.16)


@pytest.mark.parametrize(
    ("name", "joint", "delivered"),
    [
        ("actuator_dead", 2, lambda asked: 0.0 * asked),
        ("actuator_weak", 1, lambda asked: 0.7 * asked),
        ("torque_offset", 1, lambda asked: asked + 10.0),
    ],
)
def test_faulty_actuator_delivers_another_torque(name, joint, delivered):
    run = measured(f"faults/{name}").run
    asked = run.tables[topics.JOINT_COMMANDS.name]["effort"]
    torque = run.tables[topics.PLANT_TRUTH.name]["torque"]
    during = np.arange(FAULT_TICK, FAULT_TICK + 300)
    # The answer to the state of a tick is what acts until the next one.
    np.testing.assert_array_equal(torque[during + 1, joint], delivered(asked[during, joint]))
    after = np.arange(FAULT_TICK + 300, 1999)
    np.testing.assert_array_equal(torque[after + 1], asked[after])


def test_second_commander_moves_nothing():
    assert measured("faults/second_commander").run.digest == healthy().data().digest


def test_leap_of_a_clock_that_is_short_is_survived():
    fault = "faults=[{kind: clock_step, side: plant, step_ms: 500, at_s: 1, for_s: 0.1}]"
    run = simulate(load_setup("paper_arm", ["duration_s=2", fault])).data()
    assert to_safe_state_ms(run) is None
    # The controller takes what comes after for late, and keeps the torque in force for 0.4 s.
    rejected = summarise(run)["transport"]["downlink"]["rejected"]
    assert rejected == {"from_the_future": 100}


@pytest.mark.parametrize("ppm", [100, -100, 33.3, -33.3, 100_000, -100_000])
def test_drifting_clock_loses_no_command_and_shifts_the_motion(ppm):
    """The controller follows its reference ahead of the plant's time, by ppm of the time."""
    fault = f"faults=[{{kind: clock_drift, ppm: {ppm}, at_s: 0.5}}]"
    run = simulate(load_setup("paper_arm", ["duration_s=2", fault])).data()
    assert run.faults() == []
    assert summarise(run)["transport"]["downlink"]["rejected"] == {}
    stamps_s = run.times_s(topics.JOINT_STATES)
    assert stamps_s[-1] - 1.999 == pytest.approx(1e-6 * ppm * 1.499, abs=2e-9)
    age_ns = run.tables[topics.PLANT_TRUTH.name]["command_age_ns"][1:]
    assert (np.abs(age_ns - 1_000_000) <= 1).all()


def test_drift_of_100_ppm_is_two_ticks_after_20_s():
    drift = "faults=[{kind: clock_drift, ppm: 100, at_s: 0}]"
    run = simulate(load_setup("paper_arm", ["duration_s=20.001", drift])).data()
    assert run.times_s(topics.JOINT_STATES)[-1] == pytest.approx(20.0 + 0.002)


@pytest.mark.parametrize(
    "name", ["controller_killed", "encoder_noisy", "plant_clock_step", "uplink_corrupted"]
)
def test_same_bits_in_every_run_and_in_replay(tmp_path, name):
    again = simulate(load_setup(f"faults/{name}"))
    assert again.data().digest == measured(f"faults/{name}").run.digest
    again.write_log(tmp_path / "run.mcap")
    repeated = replay(again.setup, read_log(tmp_path / "run.mcap"))
    assert repeated.is_identical
    assert repeated.recorded > FAULT_TICK - 1


@pytest.mark.parametrize("how", ["frozen", "killed"])
def test_simulation_says_what_was_done_to_the_controller(how):
    faults = summarise(measured(f"faults/controller_{how}").run)["faults"]
    assert faults[0] == f"plant at 1.000 s: the controller was {how}"


@pytest.mark.parametrize("target", ["plant", "recorder"])
def test_simulation_refuses_faults_of_processes_it_has_not(target):
    fault = f"faults=[{{kind: process_killed, target: {target}, at_s: 1}}]"
    with pytest.raises(ScenarioError, match=f"target = '{target}': must be controller"):
        simulate(load_setup("paper_arm", [fault]))


def test_table_of_the_page_has_each_shipped_fault():
    shown = PAGE.read_text().split(BEGIN)[1].split(END)[0]
    assert sorted(re.findall(r"`(faults/\w+)`", shown)) == fault_scenarios()
