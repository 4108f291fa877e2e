"""Seven drives on CAN FD: their process data in FD frames, in half the time on the wire."""

from __future__ import annotations

from pathlib import Path

from deploy.judge.metrics import summarise
from deploy.judge.run_data import RunData
from deploy.run.simulate import simulate
from deploy.scenario.scenario import load_setup

VIRTUAL = ("link.can.interface=virtual", "link.can.answer_timeout_s=60", "duration_s=0.5")


def run(folder: Path, *overrides: str) -> tuple[RunData, list[str]]:
    """A run and the frames of its log."""
    data = simulate(
        load_setup("iiwa_can", [*VIRTUAL, *overrides]), can_log=folder / "can.log"
    ).data()
    lines = (folder / "can.log").read_text().splitlines()
    return data, [line.split()[2] for line in lines]


def test_process_data_goes_in_fd_frames_and_changes_nothing_else(tmp_path: Path) -> None:
    fd, frames = run(tmp_path)
    classical, classical_frames = run(tmp_path, "link.can.fd_process_data=false")
    assert summarise(fd)["completed"]
    assert summarise(fd)["bounds"]["kept"]
    assert fd.digest == classical.digest
    # the master's last command of the start, sent by canopen, is a classical frame
    in_cycle = frames[frames.index("080#") :]
    pdos = [frame for frame in in_cycle if frame[0] in "12"]
    assert len(pdos) >= 250 * 14
    assert all("##1" in frame for frame in pdos)
    assert not any("##" in frame for frame in in_cycle if frame[0] not in "12")
    content = [frame.replace("##1", "#") for frame in in_cycle[:2000]]
    assert content == classical_frames[classical_frames.index("080#") :][:2000]
    loads = [summarise(each)["transport"]["can"]["load"] for each in (fd, classical)]
    assert 0.3 < loads[0] < 0.45
    assert 0.7 < loads[1] < 0.85


def test_targets_of_drive_feedback_go_in_fd_frames_too(tmp_path: Path) -> None:
    feedback = "controller.drive_feedback.enabled=true"
    fd, frames = run(tmp_path, feedback)
    classical, _ = run(tmp_path, feedback, "link.can.fd_process_data=false", "rate_hz=250")
    assert not fd.faults()
    assert not classical.faults()
    in_cycle = frames[frames.index("080#") :]
    assert all("##1" in frame for frame in in_cycle if frame[0] in "145")
    assert sum(frame.startswith("40") for frame in in_cycle) >= 250 * 7
