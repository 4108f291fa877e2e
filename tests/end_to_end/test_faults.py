"""A process dies or freezes in the middle of a run: the arm stops, and no process is left over.

Every run is watched by a stranger on the bus, so that the disruption comes at a known time of the
run and the end of the plant is known from outside the recording.
"""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

import pytest
from running import (
    ENDLESS,
    IN_LOCKSTEP,
    PATIENT,
    ROOT,
    WIDE,
    Finished,
    Running,
    Watcher,
    assert_stopped_in_time,
    funnel_hil,
    funnel_hil_here,
    processes_of,
    settings,
    started,
)

from bus_schema.messages.topics import PLANT_TRUTH
from bus_schema.recording.mcap_log import read_log
from tests.waiting import HANG_S, await_true, free_endpoint

DISRUPTED_AT_S = 0.5
# In real time a busy machine may well hold up a loop for the 200 ms that are the default.
COMMAND_TIMEOUT_S = {"lockstep": 0.1, "realtime": 3.0}
SOON = settings(link__reply_timeout_s=5)
ON_DISK_B = 200_000
ROLES = {"controller", "plant", "recorder"}

NO_GAP_S = 1e-9
"""In lockstep nothing may be missing; in real time a loop rather drops a message than waits."""


@dataclass(frozen=True)
class DisruptedRun:
    """A run that was disrupted; how far its plant had come then, and at its end."""

    run: Finished
    disrupted_s: float
    plant_end_s: float

    @property
    def causes(self) -> list[str]:
        """The lines that say who was killed or frozen."""
        return [
            line.partition("fault")[2].strip()
            for line in self.run.output.splitlines()
            if "fault" in line and ("killed" in line or "frozen" in line)
        ]

    @property
    def unrecorded_s(self) -> float:
        """How much of the plant's time is missing at the end of the recording."""
        return self.plant_end_s - float(self.run.data.times_s(PLANT_TRUTH)[-1])


def disrupt(tmp_path, clock, number, role, *more, on_disk_b=0, with_report=False, code=1):
    """Send a signal to a process of a run, or to the run itself, in the middle of it.

    So much of the recording must be on the disk by then. The run has to end with this exit code.
    """
    timeout_ms = 1e3 * COMMAND_TIMEOUT_S[clock]
    plant = settings(clock=clock, plant__command_timeout_ms=timeout_ms)
    words = ["run", "paper_arm", *ENDLESS, *plant, *more]
    with (
        started(*words, out=tmp_path / "run", with_report=with_report) as run,
        Watcher(run.plant_endpoint()) as watcher,
    ):
        watcher.await_time(DISRUPTED_AT_S, run)
        recording = run.folder / "run.partial.mcap"
        await_true(lambda: recording.stat().st_size >= on_disk_b, "so much is on the disk")
        disrupted_s = watcher.last_stamp_ns * 1e-9
        run.send(number, role)
        ended = run.end(code)
        left_over = processes_of(run.folder)
    assert left_over == {}
    return DisruptedRun(ended, disrupted_s, watcher.last_stamp_ns * 1e-9)


@pytest.mark.parametrize(
    ("clock", "number", "fate"),
    [
        ("lockstep", signal.SIGKILL, "the controller was killed by SIGKILL"),
        ("lockstep", signal.SIGSTOP, "the controller was frozen (stopped by a signal)"),
        pytest.param("realtime", signal.SIGKILL, "the controller was killed by SIGKILL",
                     marks=pytest.mark.serial),
    ],
    ids=["killed", "frozen", "killed in real time"],
)  # fmt: skip
def test_arm_is_stopped_when_the_controller_falls_silent(tmp_path, clock, number, fate):
    disrupted = disrupt(tmp_path, clock, number, "controller", *SOON)
    assert disrupted.causes == [fate]
    assert fate in disrupted.run.summary["faults"]
    assert not disrupted.run.summary["completed"]
    assert disrupted.run.data.complete
    assert disrupted.unrecorded_s <= (NO_GAP_S if clock == "lockstep" else 3.0)
    assert_stopped_in_time(disrupted.run, COMMAND_TIMEOUT_S[clock])


def test_run_ends_when_the_plant_is_killed(tmp_path: Path) -> None:
    disrupted = disrupt(tmp_path, "lockstep", signal.SIGKILL, "plant")
    assert disrupted.causes == ["the plant was killed by SIGKILL"]
    assert not disrupted.run.summary["completed"]
    assert disrupted.run.data.complete  # the recorder finished its file
    assert disrupted.unrecorded_s <= 1.0  # it took along what waited


def test_run_ends_when_the_recorder_is_killed(tmp_path: Path) -> None:
    disrupted = disrupt(tmp_path, "lockstep", signal.SIGKILL, "recorder", on_disk_b=ON_DISK_B)
    assert disrupted.causes == ["the recorder was killed by SIGKILL"]
    assert not disrupted.run.summary["completed"]
    assert not disrupted.run.data.complete
    # What was in whole chunks is on the disk; how far behind the recorder was then, a busy machine
    # decides, where virtual time goes several times as fast as the wall's.
    assert disrupted.run.data.times_s(PLANT_TRUTH)[-1] > 0.0
    assert not (disrupted.run.folder / "run.mcap").exists()  # there is no whole recording
    assert disrupted.run.summary["recorder"]["lost"] is None  # it was not counted to the end
    for command in ("report", "replay"):
        words = command, str(disrupted.run.folder)
        looked_at = funnel_hil_here(*words, with_report=True)
        assert "The recording is incomplete" in looked_at.output


def test_full_disk_ends_the_recording_and_not_the_run(small_disk: Path) -> None:
    words = ["run", "paper_arm", *settings(clock="lockstep", duration_s=2)]
    run = funnel_hil_here(*words, out=small_disk / "run", code=1)
    assert "the recording is partial: No space left on device" in run.output
    assert run.output.count("Traceback") == 0
    assert (
        run.summary["transport"]["uplink"]["sent"] is None
    )  # reported at the end, when it was full
    assert not run.data.complete
    recorder, ticks = run.summary["recorder"], 2000
    for topic in ("joint_states", "joint_commands", "plant_status"):
        kept = len(run.data.tables[topic])
        assert 0 < kept < ticks
        assert recorder["lost_by_topic"][topic] == ticks - kept  # so the run went on to its end
    assert recorder["lost"] == sum(recorder["lost_by_topic"].values())


def test_interrupted_run_leaves_complete_files(tmp_path: Path) -> None:
    disrupted = disrupt(tmp_path, "lockstep", signal.SIGTERM, None, with_report=True, code=130)
    assert disrupted.run.summary["completed"] is False
    assert disrupted.run.summary["faults"] == []
    assert disrupted.run.data.complete
    assert disrupted.unrecorded_s <= NO_GAP_S
    assert (disrupted.run.folder / "report.html").is_file()


@pytest.mark.parametrize("moment", ["processes have started", "recording has begun"])
def test_run_can_be_interrupted_before_it_begins(tmp_path: Path, moment: str) -> None:
    def has_come(run: Running) -> bool:
        if moment == "recording has begun":
            return (run.folder / "run.partial.mcap").is_file()
        return processes_of(run.folder).keys() >= ROLES

    with started(*IN_LOCKSTEP, out=tmp_path / "run") as run:
        await_true(lambda: has_come(run), moment)
        run.send(signal.SIGINT)
        ended = run.end(130)
        left_over = processes_of(run.folder)
    assert left_over == {}
    assert ended.summary["completed"] is False
    assert ended.summary["faults"] == []  # an interruption is no fault


def test_signal_to_a_whole_process_group_interrupts_a_run(tmp_path: Path) -> None:
    """A terminal or `timeout` sends one. What the processes of a run are forked from stays alive.

    It listens at a path that must have less than 108 characters, wherever TMPDIR is.
    """
    folder, temporary = tmp_path / "run", tmp_path / ("of_a_job" * 12)
    temporary.mkdir()
    words = ["run", "paper_arm", *PATIENT, *ENDLESS, *settings(clock="lockstep")]
    words += ["--out", str(folder)]
    with subprocess.Popen(
        [sys.executable, "-m", "deploy.cli", *words],
        cwd=ROOT, env={**os.environ, "TMPDIR": str(temporary)},
        start_new_session=True, stdout=subprocess.DEVNULL,
    ) as run:  # fmt: skip

        def has_begun() -> bool:
            children = Path(f"/proc/{run.pid}/task/{run.pid}/children").read_text().split()
            lines = [Path(f"/proc/{pid}/cmdline").read_text() for pid in children]
            return any("fork_server" in line for line in lines)

        await_true(has_begun, "the fork server has started")
        os.killpg(run.pid, signal.SIGINT)
        assert run.wait(HANG_S) == 130
    summary = folder / "summary.json"  # there is none where the run had hardly begun
    assert summary.is_file() or not folder.exists()
    if summary.is_file():
        assert json.loads(summary.read_text())["faults"] == []


def test_no_process_outlives_a_run_that_was_killed_not_even_a_frozen_one(tmp_path: Path) -> None:
    with (
        started(*IN_LOCKSTEP, out=tmp_path / "run") as run,
        Watcher(run.plant_endpoint()) as watcher,
    ):
        watcher.await_time(0.1, run)
        run.send(signal.SIGSTOP, "recorder")
        run.send(signal.SIGKILL)
        await_true(lambda: not processes_of(run.folder), "the others follow")
        run.end()
    ticks = len(read_log(run.folder / "run.mcap").payloads[PLANT_TRUTH.name])
    assert ticks < 3_000_000  # of 3,600,000: they left, and did not just come to their end


def test_recorder_frozen_beyond_its_lease_records_again_and_the_gap_is_unknown(tmp_path):
    """Others close a connection over which nothing has come for 10 s."""
    realtime = settings(clock="realtime", plant__command_timeout_ms=60_000.0)
    words = ["run", "paper_arm", *ENDLESS, *WIDE, *realtime]
    with started(*words, out=tmp_path / "run") as run, Watcher(run.plant_endpoint()) as watcher:

        def wait(duration_s: float) -> None:
            watcher.await_time(watcher.last_stamp_ns * 1e-9 + duration_s, run)

        watcher.await_time(0.5, run)
        run.send(signal.SIGSTOP, "recorder")
        wait(11.5)
        run.send(signal.SIGCONT, "recorder")
        wait(5.0)
        run.send(signal.SIGINT)
        ended = run.end()
    assert (ended.code, ended.summary["faults"]) == (130, []), ended.output
    recording = ended.summary["recording"]
    assert recording["damage"] == []  # it has the plant's end
    (first_s, last_s), *_ = recording["gaps_s"]
    assert last_s - first_s > 5.0  # what a loop keeps of its own is asked for again
    assert ended.summary["verdict"] == "unknown"


@pytest.mark.parametrize(
    ("alone", "missed", "timeout_s"),
    [("plant", "controller", 2), ("controller", "plant", 0.5), ("record", "plant", 0.5)],
)
def test_process_whose_peer_never_comes_says_so_and_never_runs(tmp_path, alone, missed, timeout_s):
    """The plant waits longer than it would give a foreign client that has announced nothing."""
    nowhere = settings(
        clock="lockstep",
        link__plant_endpoint=free_endpoint(),
        link__controller_endpoint=free_endpoint(),
        link__connect_timeout_s=timeout_s,
    )
    out = tmp_path / "out" if alone == "record" else None
    ended = funnel_hil(alone, "paper_arm", *nowhere, out=out, code=1)
    output = [line for line in ended.output.splitlines() if "is silent" in line]
    assert len(output) == 1
    assert f"the {missed} is silent" in output[0]
    assert f"within {timeout_s} s" in output[0]
    assert "safe stop" not in ended.output
    assert "no valid command" not in ended.output
