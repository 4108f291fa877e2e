"""Runs over CAN with Damiao motors."""

from __future__ import annotations

import struct
from pathlib import Path

import pytest

from bus_schema.can.damiao.motors import MOTORS
from bus_schema.can.mit.codec import command_of
from tests.deploy.run.can.can_runs import CanRun, run_over_can

CLASSICAL = ("link.can.fd=false", "link.can.fd_process_data=false", "rate_hz=250")
MOTOR = MOTORS["DM8009"]


@pytest.fixture(scope="module")
def classical(tmp_path_factory: pytest.TempPathFactory) -> CanRun:
    folder = tmp_path_factory.mktemp("damiao")
    return run_over_can("openarm", "duration_s=0.4", *CLASSICAL, folder=folder)


def test_cycle_is_a_request_a_command_and_two_states_for_each_motor(classical: CanRun) -> None:
    counts = classical.summary["transport"]["can"]["frames_by_identifier"]
    feedback = {f"{0x10 + node:03X}": 200 for node in range(1, 8)}
    assert counts == {"7FF": 700} | feedback | {f"{node:03X}": 100 for node in range(1, 8)}


def test_torques_are_those_in_the_frames(classical: CanRun) -> None:
    contents = [bytes.fromhex(content) for each, content in classical.frames() if each == 2]
    torques = {command_of(data, MOTOR.ranges).torque_nm for data in contents if data[0] != 0xFF}
    assert set(classical.data.tables["joint_commands"]["effort"][:, 1]) <= torques
    assert contents[-1] == b"\xff" * 7 + b"\xfd"  # a master leaves them disabled


def test_master_checks_ranges_sets_mode_and_timeout_and_enables(classical: CanRun) -> None:
    frames = classical.frames()
    start = next(n for n, frame in enumerate(frames) if frame[1].startswith("0100CC"))
    asked = [bytes.fromhex(data) for each, data in frames[:start] if each == 0x7FF]
    first = [(data[2], data[3]) for data in asked if data[0] == 1]
    assert first == [(0x33, 21), (0x33, 22), (0x33, 23), (0x55, 10), (0x55, 9)]
    assert asked[4][4:] == struct.pack("<I", 1000)  # 50 ms
    assert (1, "FF" * 7 + "FC") in frames[:start]


def test_fd_frames_have_the_same_digest_and_a_third_of_the_load(tmp_path: Path) -> None:
    runs = [
        run_over_can("openarm", "duration_s=0.2", "rate_hz=250", *more, folder=tmp_path)
        for more in (CLASSICAL, ())
    ]
    assert len({run.summary["digest"] for run in runs}) == 1
    classical_load, load = (run.summary["transport"]["can"]["load"] for run in runs)
    assert load < 0.45 * classical_load
    assert all("##" in frame for frame in runs[1].logged)
