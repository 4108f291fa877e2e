"""Runs over CAN with drives of the MIT protocol."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from bus_schema.arrays import Vector
from bus_schema.can.mit.codec import MitRanges, Special, command_of, reply_of, special
from bus_schema.messages.topics import PLANT_TRUTH
from bus_schema.runtime.modes import Mode
from deploy.judge.metrics import summarise
from deploy.judge.run_data import RunData
from deploy.run.simulate import simulate
from deploy.scenario.scenario import load_setup
from deploy.scenario.warnings import scenario_warnings

VIRTUAL = ("link.can.interface=virtual", "controller.law=fixed_time_neural")
FEEDBACK = "controller.drive_feedback.enabled=true"
RANGES = MitRanges(4.0, 8.0, 700.0, 1e5, 2000.0)  # the shoulder's


def run(*overrides: str, log: Path | None = None) -> RunData:
    return simulate(load_setup("paper_arm_mit", [*VIRTUAL, *overrides]), can_log=log).data()


def frames(log: Path, identifier: int) -> list[bytes]:
    fields = [line.split()[2].split("#") for line in log.read_text().splitlines()]
    return [bytes.fromhex(content) for each, content in fields if int(each, 16) == identifier]


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("mit") / "can.log"


@pytest.fixture(scope="module")
def plain(log: Path) -> RunData:
    return run("duration_s=0.6", log=log)


def test_bounds_are_kept_and_errors_stay_within_what_positions_can_say(plain: RunData) -> None:
    summary = summarise(plain)
    assert plain.faults() == []
    assert summary["completed"]
    assert summary["bounds"]["kept"]
    step_rad = 2 * RANGES.position_rad / 0xFFFF
    settled: Vector = np.abs(plain.true_errors_rad[200:])
    assert settled.max() < 3 * step_rad


def test_a_cycle_is_a_request_a_command_and_two_replies_for_each_drive(
    plain: RunData, log: Path
) -> None:
    counts = summarise(plain)["transport"]["can"]["frames_by_identifier"]
    assert counts == {"000": 1800, "001": 600, "002": 600, "003": 600}
    to_shoulder = frames(log, 2)
    said = [data for data in to_shoulder if data[:-1] != b"\xff" * 7]
    positions = [reply_of(data, RANGES).position_rad for data in frames(log, 0) if data[0] == 2]
    states = plain.tables["joint_states"]["position"][:, 1]
    assert set(states) <= set(positions)
    torques = [command_of(data, RANGES).torque_nm for data in said]
    commanded = plain.tables["joint_commands"]["effort"][:, 1]
    assert set(commanded) <= set(torques)
    assert to_shoulder[-1] == special(Special.EXIT)  # where a master leaves them


def test_targets_travel_in_the_frames_and_bounds_are_kept(tmp_path: Path) -> None:
    """The drives of one run get the gains that the arm's inertia asks for, and moving targets."""
    data = run("duration_s=0.6", FEEDBACK, log=tmp_path / "can.log")
    assert summarise(data)["bounds"]["kept"]
    commands = [
        command_of(each, RANGES)
        for each in frames(tmp_path / "can.log", 2)
        if each[:-1] != b"\xff" * 7
    ]
    gains = data.setup.drive
    step = RANGES.stiffness_nm_rad / 0xFFF
    assert commands[100].stiffness_nm_rad == pytest.approx(gains.stiffness_nm_rad[1], abs=step)
    assert commands[100].velocity_rad_s != commands[200].velocity_rad_s


@pytest.mark.parametrize(
    ("fault", "reason"),
    [
        ("drive:2@300ms", "node 2: OVER_CURRENT (error 2)"),
        ("over-temperature:3@300ms", "node 3: OVER_TEMPERATURE (error 1)"),
        ("silent:2@300ms", "no answer from drive 2"),
    ],
)
def test_all_joints_come_to_rest_when_one_drive_fails(fault: str, reason: str) -> None:
    data = run("duration_s=2", f"link.can.faults.drives=['{fault}']", "link.can.answer_timeout_s=1")
    assert reason in "; ".join(data.faults())
    assert not summarise(data)["completed"]
    truth = data.tables[PLANT_TRUTH.name]
    assert truth["mode"][-1] == Mode.STOPPING
    assert np.abs(truth["velocity"][-1]).max() < 0.02


def test_torques_that_frames_cannot_say_are_told_before_the_run() -> None:
    mit = [*VIRTUAL, "link.can.protocol=mit"]
    (told,) = scenario_warnings(load_setup("paper_arm_can", mit))
    assert "base_yaw (400 N m, cut off at 18)" in told
    assert "shoulder (700 N m, cut off at 18)" in told
    wider = [*mit, "link.can.mit.torque_nm=[400, 700, 300]"]
    assert scenario_warnings(load_setup("paper_arm_can", wider)) == []
    (weak,) = scenario_warnings(load_setup("paper_arm_can", [*mit, "limits.torque_nm=18"]))
    assert weak.startswith("the reference asks shoulder for ")
    (told,) = scenario_warnings(
        load_setup("paper_arm_mit", [*VIRTUAL, "link.can.mit.torque_nm=400"])
    )
    assert "cannot say all torques of shoulder (700 N m, cut off at 400): set" in told
    assert scenario_warnings(load_setup("paper_arm_mit", VIRTUAL)) == []
