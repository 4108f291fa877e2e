"""`robot-server`: what it refuses, and the files that it leaves."""

import json

import pytest

from tests.warm_process import output_of


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["paper_arm"], "has 3 driven joints: must have 6 for --interface servoj"),
        (["ur5e", "--interface", "rsi"], "--interface rsi: must be 'servoj' or 'speedj'"),
        (["ur5e", "--interface", "servo_j"], "--interface servo_j: must be one of torque, servoj"),
        (["ur5e_motors", "--network", "nowhere.csv"], "nowhere.csv"),
    ],
)
def test_what_it_cannot_serve_is_refused(words, message):
    assert message in " ".join(output_of("robot-server", *words, code=2).split())


def test_it_leaves_its_motion_and_counts(tmp_path):
    words = ("--host", "127.0.0.59", "--duration", "0.05", "--network", "wired_lan")
    output = output_of("robot-server", "ur5e_motors", *words, "--out", tmp_path / "out")
    assert "ur5e_motors listens at 127.0.0.59: rtde 30004" in output
    summary = json.loads((tmp_path / "out" / "summary.json").read_text())
    assert summary["ticks"] >= 50
    assert (summary["commands"], summary["stops"], summary["lag_ms"]) == ({}, [], 6 * [None])
    assert summary["network"]["uplink"]["sent"] == 0
    heads = (tmp_path / "out" / "motion.csv").read_text().splitlines()[0].split(",")
    assert heads[:2] == ["time_s", "shoulder_pan_joint.position_rad"]
    assert len(heads) == 13
