"""Delays over CAN in virtual time: a controller that is far away from the bus of its drives."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import numpy as np
import pytest

from bus_schema.messages.topics import PLANT_TRUTH
from bus_schema.recording.mcap_log import read_log
from deploy.judge.metrics import summarise
from deploy.judge.run_data import RunData
from deploy.run.replay import replay
from deploy.run.simulate import Simulation, simulate
from deploy.scenario.scenario import load_setup
from plant_emulator.arm_plant import Mode

CAN = ("link.can.interface=virtual", "link.can.answer_timeout_s=20")
ROUND_TRIP_MS = 60.0
DELAYS = (
    f"link.uplink.delay_ms={ROUND_TRIP_MS / 3}",
    f"link.downlink.delay_ms={ROUND_TRIP_MS / 1.5}",
)
FEEDBACK = ("controller.drive_feedback.enabled=true",)
ODRIVE = ("link.can.protocol=cansimple", "link.can.cansimple.input_torque_scale=40")


def simulated(*overrides: str, duration_s: float = 0.6) -> Simulation:
    overrides = (*overrides, f"duration_s={duration_s}")
    compensated = "controller.delay_compensation.enabled=true"
    return simulate(load_setup("paper_arm_can", [compensated, *overrides]))


@cache
def over_zenoh(*overrides: str) -> RunData:
    return simulated("link.kind=zenoh", *DELAYS, *overrides).data()


@pytest.mark.parametrize("feedback", [(), FEEDBACK])
@pytest.mark.parametrize("protocol", [(), ODRIVE])
def test_delays_over_can_do_what_they_do_over_zenoh(
    protocol: tuple[str, ...], feedback: tuple[str, ...]
) -> None:
    can = simulated(*CAN, *DELAYS, *protocol, *feedback).data()
    zenoh = over_zenoh(*feedback)
    ours, reference = summarise(can), summarise(zenoh)
    assert ours["completed"]
    assert ours["bounds"]["kept"]
    assert ours["bounds"]["margin_min"] == pytest.approx(
        reference["bounds"]["margin_min"], abs=2e-3
    )
    assert ours["timing"]["round_trip_us"]["p50"] == ROUND_TRIP_MS * 1e3
    assert ours["timing"]["deadline_misses"] == reference["timing"]["deadline_misses"]
    off_rad = np.abs(can.true_errors_rad[-1] - zenoh.true_errors_rad[-1])
    assert off_rad.max() < 1e-3


def test_first_torque_acts_after_a_round_trip() -> None:
    data = simulated(
        *CAN, "link.uplink.delay_ms=4", "link.downlink.delay_ms=3.5", duration_s=0.02
    ).data()
    truth = data.tables[PLANT_TRUTH.name]
    acts = np.abs(truth["torque"]).max(axis=1) > 0.0
    assert data.times_s(PLANT_TRUTH)[acts][0] == pytest.approx(0.008)


def test_delayed_run_over_can_is_replayed_bit_for_bit(tmp_path: Path) -> None:
    simulation = simulated(*CAN, *DELAYS, *FEEDBACK, duration_s=0.3)
    simulation.write_log(tmp_path / "run.mcap")
    found = replay(simulation.setup, read_log(tmp_path / "run.mcap"))
    assert found.recorded > 100
    assert found.is_identical


def test_drives_come_to_rest_when_one_fails_far_away_from_its_master() -> None:
    data = simulated(
        *CAN, *DELAYS, "link.can.faults.drives=['drive:2@200ms']", duration_s=2.0
    ).data()
    assert "node 2: short circuit" in "; ".join(data.faults())
    truth = data.tables[PLANT_TRUTH.name]
    assert truth["mode"][-1] == Mode.STOPPING
    assert not truth["torque"][-1].any()
    assert np.abs(truth["velocity"][-1]).max() < 0.02
