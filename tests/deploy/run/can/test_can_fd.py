"""Seven drives on CAN FD: their process data in FD frames, in half the time on the wire."""

from __future__ import annotations

from pathlib import Path

from tests.deploy.run.can.can_runs import FEEDBACK, CanRun, run_over_can


def run(folder: Path, *overrides: str) -> CanRun:
    return run_over_can("iiwa_can", "duration_s=0.5", *overrides, folder=folder)


def test_process_data_goes_in_fd_frames_and_changes_nothing_else(tmp_path: Path) -> None:
    fd = run(tmp_path)
    frames = fd.logged
    classical = run(tmp_path, "link.can.fd_process_data=false")
    assert fd.summary["completed"]
    assert fd.summary["bounds"]["kept"]
    assert fd.data.digest == classical.data.digest
    # the master's last command of the start, sent by canopen, is a classical frame
    in_cycle = frames[frames.index("080#") :]
    pdos = [frame for frame in in_cycle if frame[0] in "12"]
    assert len(pdos) >= 250 * 14
    assert all("##1" in frame for frame in pdos)
    assert not any("##" in frame for frame in in_cycle if frame[0] not in "12")
    content = [frame.replace("##1", "#") for frame in in_cycle[:2000]]
    assert content == classical.logged[classical.logged.index("080#") :][:2000]
    loads = [each.summary["transport"]["can"]["load"] for each in (fd, classical)]
    assert 0.3 < loads[0] < 0.45
    assert 0.7 < loads[1] < 0.85


def test_targets_of_drive_feedback_go_in_fd_frames_too(tmp_path: Path) -> None:
    fd = run(tmp_path, FEEDBACK)
    in_cycle = fd.logged[fd.logged.index("080#") :]
    classical = run(tmp_path, FEEDBACK, "link.can.fd_process_data=false", "rate_hz=250")
    assert (fd.faults, classical.faults) == ("", "")
    assert all("##1" in frame for frame in in_cycle if frame[0] in "145")
    assert sum(frame.startswith("40") for frame in in_cycle) >= 250 * 7
