"""Whole simulations over an impaired link."""

from __future__ import annotations

import numpy as np
import pytest

from bus_schema.messages import topics
from deploy.judge.bounds import bound_usage
from deploy.judge.metrics import summarise
from deploy.run.simulate import simulate
from deploy.scenario.scenario import load_setup

SHORT = "duration_s=0.6"
HARSH = (
    "link.uplink={delay_ms: 2, jitter_ms: 3, distribution: pareto, reorder: true, duplicate: 0.1,"
    " burst_loss: {p: 0.05, r: 0.4}}",
    "link.downlink={delay_ms: 1, jitter_ms: 2, distribution: normal, correlation: 0.5,"
    " reorder: true, duplicate: 0.1, loss: 0.05}",
)


def run_of(*overrides):
    return simulate(load_setup("paper_arm", [SHORT, *overrides])).data()


def truth_of(run):
    return run.tables[topics.PLANT_TRUTH.name]


@pytest.fixture(scope="module")
def plain():
    return run_of()


@pytest.fixture(scope="module")
def harsh():
    return run_of(*HARSH)


@pytest.mark.parametrize("substeps", [1, 2, 4])
def test_without_delay_the_answer_to_a_state_acts_until_the_next_tick(substeps):
    run = run_of(f"plant.substeps={substeps}")
    torque = truth_of(run)["torque"]
    commands = run.tables[topics.JOINT_COMMANDS.name]["effort"]
    # Saturation and lag are off, so that the actuators give what the newest command asks for:
    # at tick k the one that answers the state of tick k - 1.
    ticks = min(len(torque) - 1, len(commands))
    assert ticks > 500
    np.testing.assert_array_equal(torque[1 : ticks + 1], commands[:ticks])


@pytest.mark.parametrize(
    "zero",
    [
        ["link.uplink.jitter_ms=0", "link.downlink.loss=0", "link.uplink.correlation=0.5"],
        ["link.uplink.schedule=[{kind: step, at_s: 0.3, delay_ms: 0}]"],
        ["link.downlink.burst_loss={p: 0, r: 0.5}", "link.uplink.reorder=true"],
        ["link.playout_ms=0"],
    ],
    ids=["values", "schedule", "chain", "playout"],
)
def test_impairment_of_nothing_gives_the_same_bits(plain, zero):
    assert run_of(*zero).digest == plain.digest


def test_seed_decides_everything(harsh):
    assert run_of(*HARSH).digest == harsh.digest
    assert run_of(*HARSH, "seed=9").digest != harsh.digest


def test_run_over_a_harsh_link_goes_to_its_end(harsh):
    summary = summarise(harsh)
    assert (summary["completed"], summary["faults"]) == (True, [])
    uplink, downlink = (summary["transport"][way] for way in ("uplink", "downlink"))
    for way in (uplink, downlink):
        assert min(way[name] for name in ("lost", "duplicated", "reordered")) > 0
        assert way["delay_ms"]["p50"] < way["delay_ms"]["p99"] < way["delay_ms"]["max"]
    # Each delivered state is answered; answers to late and doubled ones are stale at the door.
    assert len(harsh.tables[topics.JOINT_COMMANDS.name]) == uplink["delivered"]
    assert downlink["rejected"]["stale"] >= uplink["duplicated"]
    assert downlink["sent"] == uplink["delivered"] - downlink["rejected"]["stale"]


def test_controller_knows_the_command_in_force(harsh):
    status = harsh.tables[topics.PLANT_STATUS.name]
    truth = truth_of(harsh)
    ticks = np.round(status["header.stamp.sec"] * 1e3 + status["header.stamp.nanosec"] * 1e-6)
    for name in ("command_sequence", "command_age_ns"):
        assert np.array_equal(status[name], truth[name][ticks.astype(int)])


def test_playout_turns_jitter_into_a_constant_round_trip():
    jitter = "delay_ms: 3, jitter_ms: 1, distribution: uniform"
    run = run_of(
        f"link.uplink={{{jitter}}}", f"link.downlink={{{jitter}, reorder: true}}",
        "link.playout_ms=9", "controller.law=smc",
    )  # fmt: skip
    summary = summarise(run)
    assert set(summary["timing"]["round_trip_us"].values()) == {9000.0}
    # With 9 ms from stamp to torque, the command in force answers the state of 9 ticks ago.
    assert set(truth_of(run)["command_age_ns"][10:].tolist()) == {9_000_000}
    assert summary["timing"]["deadline_misses"] == 0  # allowed: the play-out and a period


@pytest.mark.parametrize(
    ("link", "deadline_ms"),
    [
        (["link.uplink.jitter_ms=1", "link.uplink.delay_ms=2", "link.downlink.delay_ms=3"], 6),
        (["link.uplink.delay_ms=2", "link.playout_ms=7"], 8),
        (["link.uplink.delay_ms=9", "link.playout_ms=7"], 10),
        (["link.uplink.delay_ms=9", "link.deadline_ms=4"], 4),
    ],
    ids=["means", "playout", "longer mean", "given"],
)
def test_deadline_is_a_period_beyond_the_mean_round_trip(link, deadline_ms):
    truth = truth_of(run_of(*link, "duration_s=0.1"))
    since_start_ns = np.arange(len(truth)) * 1_000_000
    ages_ns = np.where(truth["command_age_ns"] >= 0, truth["command_age_ns"], since_start_ns)
    assert np.array_equal(truth["deadline_met"] == 1, ages_ns <= deadline_ms * 1_000_000)


def test_long_round_trip_does_not_trip_the_watchdog_at_the_start():
    link = ["link.uplink.delay_ms=24", "link.downlink.delay_ms=24", "controller.law=smc"]
    run = run_of(*link, "plant.command_timeout_ms=20")
    assert run.faults() == []
    assert summarise(run)["completed"]


def test_silence_from_the_first_message_on_trips_it():
    run = run_of("link.uplink={delay_ms: 5, loss: 1}", "plant.command_timeout_ms=20")
    assert run.faults() == [
        "plant at 0.025 s: no valid command for 20 ms (plant.command_timeout_ms): safe stop (brake)"
    ]
    assert summarise(run)["transport"]["uplink"]["delivered"] == 0


@pytest.mark.parametrize(
    ("way", "at_s", "law", "is_lost"),
    [
        ("uplink", 2.5, "fixed_time_neural", False),
        ("downlink", 2.5, "smc", True),
        # where most is lost of what the network knows: the funnel has to open again
        ("downlink", 9.95, "fixed_time_neural", False),
    ],
)
def test_outage_costs_the_bounds_for_no_longer_than_it_takes_to_come_back(way, at_s, law, is_lost):
    outage = f"link.{way}.schedule=[{{kind: outage, at_s: {at_s}, for_s: 0.1}}]"
    settings = [f"controller.law={law}", f"duration_s={at_s + 1}", "plant.command_timeout_ms=200"]
    run = run_of(outage, *settings)
    summary = summarise(run)
    assert (summary["completed"], summary["faults"]) == (True, [])
    times_s = run.times_s(topics.PLANT_TRUTH)
    lost_s = times_s[(bound_usage(run) >= 1.0).any(axis=1)]
    assert summary["bounds"]["kept"] is not is_lost
    assert np.all((lost_s >= at_s) & (lost_s <= at_s + 0.1 + 0.5))
    channel = summary["transport"][way]
    assert (channel["lost"], channel["loss_burst"]) == (100, {"mean": 100.0, "longest": 100})
    assert summary["timing"]["deadline_miss_longest_run"] == pytest.approx(100, abs=1)


def test_one_state_that_comes_twice_is_judged_like_one():
    outage = "[{kind: outage, at_s: 0.0005, for_s: 10}]"
    run = run_of(f"link.uplink={{duplicate: 1, schedule: {outage}}}")
    assert len(run.tables[topics.JOINT_COMMANDS.name]) == 2
    assert set(summarise(run)["torque"].values()) == {None}


def test_outage_longer_than_the_timeout_stops_the_arm():
    outage = "link.uplink.schedule=[{kind: outage, at_s: 0.2, for_s: 0.1}]"
    run = run_of(outage, "plant.command_timeout_ms=60")
    # The last state before it is of 0.199 s; the substep after 0.259 s is the first that is late.
    assert run.faults() == [
        "plant at 0.259 s: no valid command for 60 ms (plant.command_timeout_ms): safe stop (brake)"
    ]
