"""Delays over CAN in virtual time: a controller that is far away from the bus of its drives."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import numpy as np
import pytest

from bus_schema.messages.topics import PLANT_TRUTH
from bus_schema.recording.mcap_log import read_log
from deploy.run.replay import replay
from deploy.run.simulate import simulate
from deploy.scenario.scenario import load_setup
from tests.deploy.run.can.can_runs import CANSIMPLE, FEEDBACK, VIRTUAL, CanRun, run_over_can

ROUND_TRIP_MS = 60.0
DELAYS = (
    f"link.uplink.delay_ms={ROUND_TRIP_MS / 3}",
    f"link.downlink.delay_ms={ROUND_TRIP_MS / 1.5}",
)


def simulated(*overrides: str, duration_s: float = 0.6) -> CanRun:
    compensated = "controller.delay_compensation.enabled=true"
    return run_over_can("paper_arm_can", compensated, f"duration_s={duration_s}", *overrides)


@cache
def over_zenoh(*overrides: str) -> CanRun:
    return simulated("link.kind=zenoh", *DELAYS, *overrides)


@pytest.mark.parametrize("feedback", [(), (FEEDBACK,)])
@pytest.mark.parametrize("protocol", [(), CANSIMPLE])
def test_delays_over_can_do_what_they_do_over_zenoh(protocol, feedback):
    can, zenoh = simulated(*DELAYS, *protocol, *feedback), over_zenoh(*feedback)
    ours, reference = can.summary, zenoh.summary
    assert ours["completed"]
    assert ours["bounds"]["kept"]
    assert ours["bounds"]["margin_min"] == pytest.approx(
        reference["bounds"]["margin_min"], abs=2e-3
    )
    assert ours["timing"]["round_trip_us"]["p50"] == ROUND_TRIP_MS * 1e3
    assert ours["timing"]["deadline_misses"] == reference["timing"]["deadline_misses"]
    off_rad = np.abs(can.data.true_errors_rad[-1] - zenoh.data.true_errors_rad[-1])
    assert off_rad.max() < 1e-3


def test_first_torque_acts_after_a_round_trip() -> None:
    delays = ("link.uplink.delay_ms=4", "link.downlink.delay_ms=3.5")
    data = simulated(*delays, duration_s=0.02).data
    truth = data.tables[PLANT_TRUTH.name]
    acts = np.abs(truth["torque"]).max(axis=1) > 0.0
    assert data.times_s(PLANT_TRUTH)[acts][0] == pytest.approx(0.008)


def test_delayed_run_over_can_is_replayed_bit_for_bit(tmp_path: Path) -> None:
    setup = load_setup("paper_arm_can", [*VIRTUAL, *DELAYS, FEEDBACK, "duration_s=0.3"])
    simulation = simulate(setup)
    simulation.write_log(tmp_path / "run.mcap")
    found = replay(simulation.setup, read_log(tmp_path / "run.mcap"))
    assert found.recorded > 100
    assert found.is_identical


def test_drives_come_to_rest_when_one_fails_far_away_from_its_master() -> None:
    run = simulated(*DELAYS, "link.can.faults.drives=['drive:2@200ms']", duration_s=2.0)
    assert "node 2: short circuit" in run.faults
    run.assert_stopped()
