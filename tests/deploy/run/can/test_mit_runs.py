"""Runs over CAN with drives of the MIT protocol."""

from __future__ import annotations

from pathlib import Path

import pytest

from bus_schema.can.mit.codec import MitRanges, Special, command_of, reply_of, special
from deploy.scenario.checking.warnings import scenario_warnings
from deploy.scenario.scenario import load_setup
from tests.deploy.run.can.can_runs import FEEDBACK, VIRTUAL, CanRun, run_over_can

LAW = "controller.law=fixed_time_neural"
RANGES = MitRanges(4.0, 8.0, 700.0, 1e5, 2000.0)  # the shoulder's


def frames_to(run: CanRun, identifier: int) -> list[bytes]:
    return [bytes.fromhex(content) for each, content in run.frames() if each == identifier]


@pytest.fixture(scope="module")
def plain(tmp_path_factory: pytest.TempPathFactory) -> CanRun:
    return run_over_can(
        "paper_arm_mit", LAW, "duration_s=0.6", folder=tmp_path_factory.mktemp("mit")
    )


def test_a_cycle_is_a_request_a_command_and_two_replies_for_each_drive(plain: CanRun) -> None:
    counts = plain.summary["transport"]["can"]["frames_by_identifier"]
    assert counts == {"000": 1800, "001": 600, "002": 600, "003": 600}
    to_shoulder = frames_to(plain, 2)
    commands_data = [data for data in to_shoulder if data[:-1] != b"\xff" * 7]
    positions = [
        reply_of(data, RANGES).position_rad for data in frames_to(plain, 0) if data[0] == 2
    ]
    states = plain.data.tables["joint_states"]["position"][:, 1]
    assert set(states) <= set(positions)
    torques = [command_of(data, RANGES).torque_nm for data in commands_data]
    commanded = plain.data.tables["joint_commands"]["effort"][:, 1]
    assert set(commanded) <= set(torques)
    assert to_shoulder[-1] == special(Special.DISABLE)  # where a master leaves them


def test_targets_travel_in_the_frames_and_bounds_are_kept(tmp_path: Path) -> None:
    """The drives of one run get the gains that the arm's inertia asks for, and moving targets."""
    run = run_over_can("paper_arm_mit", LAW, "duration_s=0.6", FEEDBACK, folder=tmp_path)
    assert run.summary["bounds"]["kept"]
    commands_data = [each for each in frames_to(run, 2) if each[:-1] != b"\xff" * 7]
    commands = [command_of(each, RANGES) for each in commands_data]
    gains = run.data.setup.drive
    step = RANGES.stiffness_nm_rad / 0xFFF
    assert commands[100].stiffness_nm_rad == pytest.approx(gains.stiffness_nm_rad[1], abs=step)
    assert commands[100].velocity_rad_s != commands[200].velocity_rad_s


def test_torques_beyond_the_frames_are_warned_of_before_the_run() -> None:
    mit = [*VIRTUAL, LAW, "link.can.protocol=mit"]
    (warning,) = scenario_warnings(load_setup("paper_arm_can", mit))
    assert "base_yaw (400 N m, cut off at 18)" in warning
    assert "shoulder (700 N m, cut off at 18)" in warning
    wider = [*mit, "link.can.mit.torque_nm=[400, 700, 300]"]
    assert scenario_warnings(load_setup("paper_arm_can", wider)) == []
    (weak,) = scenario_warnings(load_setup("paper_arm_can", [*mit, "limits.torque_nm=18"]))
    assert weak.startswith("the reference needs shoulder to deliver ")
    (warning,) = scenario_warnings(
        load_setup("paper_arm_mit", [*VIRTUAL, LAW, "link.can.mit.torque_nm=400"])
    )
    assert "cannot represent all torques of shoulder (700 N m, cut off at 400): set" in warning
    assert scenario_warnings(load_setup("paper_arm_mit", [*VIRTUAL, LAW])) == []
