"""Runs over CAN with drives that answer requests: MIT, Damiao, moteus."""

from __future__ import annotations

import math
import struct
from functools import cache

import numpy as np
import pytest

from bus_schema.can.damiao.codec import feedback_of
from bus_schema.can.damiao.motors import MOTORS
from bus_schema.can.mit.codec import MitRanges, command_of, reply_of
from deploy.scenario.checking.warnings import scenario_warnings
from deploy.scenario.scenario import load_setup
from tests.deploy.run.can.can_runs import (
    FEEDBACK,
    MOTEUS,
    VIRTUAL,
    holds_in_one_piece,
    run_over_can,
)

MIT = ("paper_arm_mit", "controller.law=fixed_time_neural", "duration_s=0.6")
CLASSICAL = ("link.can.fd=false", "link.can.fd_process_data=false", "rate_hz=250")
MIT_RANGES = MitRanges(4.0, 8.0, 700.0, 1e5, 2000.0)  # the shoulder's
DAMIAO_RANGES = MOTORS["DM8009"].ranges
SPECIAL = b"\xff" * 7
MOTORS_OF_ARM = range(1, 8)


def mit_torque(ranges):
    return lambda data: None if data[:7] == SPECIAL else command_of(data, ranges).torque_nm


def moteus_torque(data):
    """Decode MODE 10 and five floats from 0x020 on, of which 0x022 is torque (reference's book)."""
    is_command = data[:6].hex() == "01000a0c0520"
    return float(struct.unpack_from("<f", data, 14)[0]) if is_command else None


# Scenario and overrides; frames by identifier; decoders of frames to drive 2 with a torque, and of
# those from it with a position; their identifier; the frame with which a master leaves a drive.
CYCLES = {
    "mit": (  # a request, a command and two replies for each drive
        MIT, {"000": 1800, "001": 600, "002": 600, "003": 600}, mit_torque(MIT_RANGES),
        lambda data: reply_of(data, MIT_RANGES).position_rad if data[0] == 2 else None,
        0, SPECIAL + b"\xfd",
    ),
    "damiao": (  # a request, a command and two states for each motor
        ("openarm", "duration_s=0.4", *CLASSICAL),
        {"7FF": 700, **{f"{0x10 + node:03X}": 200 for node in MOTORS_OF_ARM},
         **{f"{node:03X}": 100 for node in MOTORS_OF_ARM}},
        mit_torque(DAMIAO_RANGES), lambda data: feedback_of(data, DAMIAO_RANGES).position_rad,
        0x12, SPECIAL + b"\xfd",
    ),
    "moteus": (  # a query, a state and a command for each drive
        ("iiwa_can", MOTEUS, "duration_s=0.6"),
        {name: 300 for node in MOTORS_OF_ARM
         for name in (f"{0x8000 | node:08X}", f"{node << 8:03X}", f"{node:03X}")},
        moteus_torque, lambda data: 2.0 * math.pi * struct.unpack_from("<f", data, 5)[0],
        2 << 8, b"\x01\x00\x00",
    ),
}  # fmt: skip


@pytest.fixture(scope="module")
def run_of(tmp_path_factory):
    return cache(lambda name: run_over_can(*CYCLES[name][0], folder=tmp_path_factory.mktemp(name)))


@pytest.mark.parametrize("protocol", CYCLES)
def test_cycle_has_the_frames_of_its_protocol(run_of, protocol):
    summary = run_of(protocol).summary
    assert (summary["faults"], summary["completed"]) == ([], True)
    assert summary["transport"]["can"]["frames_by_identifier"] == CYCLES[protocol][1]
    assert summary["transport"]["can"]["rejected"] == {}


@pytest.mark.parametrize("protocol", CYCLES)
def test_positions_and_torques_are_those_in_the_frames(run_of, protocol):
    run, (_, _, torque, position, state, last) = run_of(protocol), CYCLES[protocol]
    commands, tables = run.contents(2), run.data.tables
    torques = [each for each in map(torque, commands) if each is not None]
    commanded = tables["joint_commands"]["effort"][:, 1]
    assert holds_in_one_piece(np.float32(torques), np.float32(commanded))
    positions = set(map(position, run.contents(state)))
    assert set(tables["joint_states"]["position"][:, 1]) <= positions
    assert commands[-1] == last


def test_master_of_damiao_motors_checks_ranges_sets_mode_and_timeout_and_enables(run_of):
    frames = run_of("damiao").frames()
    start = next(n for n, frame in enumerate(frames) if frame[1].startswith("0100CC"))
    asked = [bytes.fromhex(data) for each, data in frames[:start] if each == 0x7FF]
    first = [(data[2], data[3]) for data in asked if data[0] == 1]
    assert first == [(0x33, 21), (0x33, 22), (0x33, 23), (0x55, 10), (0x55, 9)]
    assert asked[4][4:] == struct.pack("<I", 1000)  # 50 ms
    assert (1, "FF" * 7 + "FC") in frames[:start]


def test_fd_frames_of_damiao_motors_have_the_same_digest_and_a_third_of_the_load(tmp_path):
    runs = [
        run_over_can("openarm", "duration_s=0.2", "rate_hz=250", *more, folder=tmp_path)
        for more in (CLASSICAL, ())
    ]
    assert len({run.summary["digest"] for run in runs}) == 1
    classical_load, load = (run.summary["transport"]["can"]["load"] for run in runs)
    assert load < 0.45 * classical_load
    assert all("##" in frame for frame in runs[1].logged)


def test_targets_travel_in_mit_frames_and_bounds_are_kept(tmp_path):
    """The drives of one run get the gains that the arm's inertia asks for, and moving targets."""
    run = run_over_can(*MIT, FEEDBACK, folder=tmp_path)
    assert run.summary["bounds"]["kept"]
    data = [each for each in run.contents(2) if each[:7] != SPECIAL]
    commands = [command_of(each, MIT_RANGES) for each in data]
    gains = run.data.setup.drive
    step = MIT_RANGES.stiffness_nm_rad / 0xFFF
    assert commands[100].stiffness_nm_rad == pytest.approx(gains.stiffness_nm_rad[1], abs=step)
    assert commands[100].velocity_rad_s != commands[200].velocity_rad_s


CUT_OFF = "shoulder (700 N m, cut off at"


@pytest.mark.parametrize(
    ("scenario", "overrides", "words"),
    [
        ("paper_arm_can", ["link.can.protocol=mit"],
         ["base_yaw (400 N m, cut off at 18)", f"{CUT_OFF} 18)"]),
        ("paper_arm_can", ["link.can.protocol=mit", "link.can.mit.torque_nm=[400, 700, 300]"], []),
        ("paper_arm_can", ["link.can.protocol=mit", "limits.torque_nm=18"],
         ["the reference needs shoulder to deliver "]),
        ("paper_arm_mit", ["link.can.mit.torque_nm=400"],
         [f"cannot represent all torques of {CUT_OFF} 400): set"]),
        ("paper_arm_mit", [], []),
    ],
)  # fmt: skip
def test_torques_beyond_mit_frames_are_warned_of_before_the_run(scenario, overrides, words):
    found = scenario_warnings(load_setup(scenario, [*VIRTUAL, MIT[1], *overrides]))
    assert len(found) == bool(words)
    assert [each for each in words if each not in found[0]] == []


def test_moteus_that_its_master_gave_up_damps_its_joint_while_the_others_rest():
    """moteus has no brake command: the drive damps the joint until it is stopped."""
    faults = "link.can.faults.drives=['silent:2@300ms']", "link.can.answer_timeout_s=2"
    run = run_over_can("iiwa_can", MOTEUS, "duration_s=0.8", *faults)
    assert "no answer from drive 2" in run.faults
    assert np.flatnonzero(run.data.tables["plant_truth"]["torque"][-1]).tolist() == [1]
    assert run.speed[-1] < 0.5


def test_moteus_drives_that_lose_their_master_time_out_and_damp_their_joints():
    """Untuned gains would turn light joints at 60 rad/s."""
    run = run_over_can("iiwa_can", MOTEUS, "duration_s=1", "link.can.faults.bus_off_s=0.3")
    assert "node 7: command timeout (mode 11)" in run.faults
    assert run.speed[-1] < 0.5
