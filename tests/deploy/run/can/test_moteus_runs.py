"""Runs over CAN with emulated moteus controllers."""

from __future__ import annotations

import struct

import numpy as np
import pytest

from tests.deploy.run.can.can_runs import CanRun, run_over_can

MOTEUS = "link.can.protocol=moteus"


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> CanRun:
    folder = tmp_path_factory.mktemp("moteus")
    return run_over_can("iiwa_can", MOTEUS, "duration_s=0.6", folder=folder)


def test_loop_is_a_query_a_state_and_a_command_for_each_drive(run: CanRun) -> None:
    assert run.summary["faults"] == []
    assert run.summary["verdict"] == "kept"
    counts = run.summary["transport"]["can"]["frames_by_identifier"]
    nodes = range(1, 8)
    assert counts == {
        name: 300
        for node in nodes
        for name in (f"{0x8000 | node:08X}", f"{node << 8:03X}", f"{node:03X}")
    }
    assert run.summary["transport"]["can"]["rejected"] == {}


def test_torques_are_those_in_the_frames(run: CanRun) -> None:
    """By the reference's book: MODE 10, five floats from 0x020 on, of which 0x022 is torque."""
    written = [
        bytes.fromhex(each.split("##1")[1]) for each in run.logged if each.startswith("002#")
    ]
    torques = [
        struct.unpack_from("<f", data, 14)[0]
        for data in written
        if data[:6].hex() == "01000a0c0520"
    ]
    given = run.data.tables["joint_commands"]["effort"][:, 1]
    assert torques == np.float32(given).tolist()
    assert written[-1] == bytes(2).join((b"\x01", b""))  # a master leaves them stopped


def test_drive_that_its_master_gave_up_damps_its_joint_while_the_others_rest() -> None:
    """moteus has no brake command: the drive damps the joint until it is stopped."""
    faults = "link.can.faults.drives=['silent:2@300ms']", "link.can.answer_timeout_s=2"
    run = run_over_can("iiwa_can", MOTEUS, "duration_s=0.8", *faults)
    assert "no answer from drive 2" in run.faults
    assert np.flatnonzero(run.data.tables["plant_truth"]["torque"][-1]).tolist() == [1]
    assert run.speed[-1] < 0.5


def test_drives_that_lose_their_master_time_out_and_damp_their_joints() -> None:
    """Light joints too: with gains that nobody tuned they would turn at 60 rad/s."""
    run = run_over_can("iiwa_can", MOTEUS, "duration_s=1", "link.can.faults.bus_off_s=0.3")
    assert "node 7: command timeout (mode 11)" in run.faults
    assert run.speed[-1] < 0.5
