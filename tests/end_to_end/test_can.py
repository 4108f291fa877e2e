"""Runs over CAN as processes, and what happens when the master dies."""

from __future__ import annotations

import signal
from pathlib import Path

import numpy as np
from running import ENDLESS, Watcher, funnel_hil, funnel_hil_here, processes_of, settings, started

from bus_schema.messages.topics import PLANT_TRUTH
from deploy.run.replay import replay
from deploy.run.run_folder import load_run
from deploy.run.simulate import simulate
from deploy.scenario.scenario import load_setup
from tests.multicast import own_place
from tests.waiting import await_true

SLOW_DOWN_S = 0.3
ANSWER_TIMEOUT_S = 60


def on_free_port() -> list[str]:
    return settings(link__can__port=own_place()[1], link__can__answer_timeout_s=ANSWER_TIMEOUT_S)


def test_run_gives_the_digest_of_the_virtual_bus_and_replays(tmp_path: Path) -> None:
    words = ["run", "paper_arm_can", *on_free_port(), *settings(duration_s=1)]
    run = funnel_hil(*words, out=tmp_path / "run", with_report=True)
    virtual = load_setup("paper_arm_can", ["duration_s=1", "link.can.interface=virtual"])
    assert run.digest == simulate(virtual).data().digest
    assert run.summary["transport"]["can"]["frames_by_identifier"]["080"] == 500
    assert (run.folder / "report.html").is_file()
    assert "identical" in funnel_hil_here("replay", str(run.folder)).output


def test_runs_at_the_same_time_do_not_meet(tmp_path: Path) -> None:
    """The shipped scenario names no bus; the drives of both runs have the same addresses."""
    patient = settings(link__can__answer_timeout_s=ANSWER_TIMEOUT_S)
    endless = settings(duration_s=3600.0, controller__law="smc")
    with started("run", "openarm", *patient, *endless, out=tmp_path / "other") as other:
        with Watcher(other.plant_endpoint()) as watcher:
            watcher.await_time(0.1, other)
            run = funnel_hil(
                "run", "openarm", *patient, *settings(duration_s=0.4), out=tmp_path / "run"
            )
            watcher.await_time(watcher.last_stamp_ns * 1e-9 + 0.1, other)  # it went on meanwhile
        other.send(signal.SIGINT)
        ended = other.end()
    alone = load_setup("openarm", ["duration_s=0.4", "link.can.interface=virtual"])
    assert run.digest == simulate(alone).data().digest
    assert run.summary["verdict"] == "kept"
    # in each of 200 cycles, from each of 7 motors, answers to a request and to a command
    counts = run.summary["transport"]["can"]["frames_by_identifier"]
    motors = range(1, 8)
    feedback = {f"{0x10 + node:03X}": 400 for node in motors}
    assert counts == {"7FF": 1400} | feedback | {f"{node:03X}": 200 for node in motors}
    assert (ended.code, ended.summary["faults"]) == (130, [])
    counts = ended.summary["transport"]["can"]["frames_by_identifier"]
    assert counts["7FF"] == 7 * len(ended.data.tables["joint_states"])
    assert all(
        counts[f"{0x10 + node:03X}"] == counts["7FF"] // 7 + counts[f"{node:03X}"]
        for node in motors
    )


def test_interrupted_run_blames_no_drive(tmp_path: Path) -> None:
    patient = settings(
        plant__command_timeout_ms=30_000.0,
        link__can__command_timeout_ms=30_000,
        link__can__heartbeat_timeout_ms=30_000,
    )
    words = ["run", "paper_arm_can", *on_free_port(), *ENDLESS, *settings(clock="lockstep")]
    with started(*words, *patient, out=tmp_path / "run") as run:
        log = run.folder / "can.log"
        await_true(lambda: log.is_file() and log.stat().st_size > 50_000, "the drives follow")
        run.send(signal.SIGINT)
        ended = run.end(130)
    assert ended.summary["faults"] == []
    assert ended.summary["completed"] is False


def test_recording_in_real_time_is_replayed_without_the_states_that_the_master_missed(tmp_path):
    in_real_time = settings(duration_s=0.5, clock="realtime", controller__law="smc")
    run = funnel_hil("run", "paper_arm_can", *on_free_port(), *in_real_time, out=tmp_path / "run")
    replayed = funnel_hil_here("replay", str(run.folder))
    assert "identical" in replayed.output
    data, contents = load_run(run.folder)
    del contents.payloads["joint_states"][100:]
    found = replay(data.setup, contents)
    assert "no recorded state is the one answered at" in found.failure
    assert not found.is_identical
    data, contents = load_run(run.folder)
    contents.payloads["joint_commands"].append(contents.payloads["joint_commands"][-1])
    assert not replay(data.setup, contents).is_identical


def test_all_axes_come_to_rest_when_the_master_is_killed(tmp_path: Path) -> None:
    words = ["run", "paper_arm_can", *on_free_port(), *ENDLESS]
    with started(*words, out=tmp_path / "run") as run:
        with Watcher(run.plant_endpoint()) as watcher:
            watcher.await_time(0.5, run)
            run.send(signal.SIGKILL, "controller")
            ended = run.end(1)
        assert processes_of(run.folder) == {}
    faults = "; ".join(ended.summary["faults"])
    assert "the controller was killed by SIGKILL" in faults
    assert "no RPDO within its event time (0x8250)" in faults
    assert "081#5082" in (run.folder / "can.log").read_text()  # the emergency of node 1
    truth, times_s = ended.data.tables[PLANT_TRUTH.name], ended.data.times_s(PLANT_TRUTH)
    moving = np.abs(truth["velocity"]).max(axis=1) > 0.02
    last_command_s = times_s[truth["round_trip_ns"] >= 0][-1]
    # link.can.command_timeout_ms, the drives' slow-down, and two ticks to see either
    allowed_s = 0.05 + SLOW_DOWN_S + 4 * 0.002
    assert times_s[moving][-1] - last_command_s <= allowed_s
