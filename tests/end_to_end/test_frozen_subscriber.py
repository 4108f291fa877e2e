"""A foreign subscriber that is frozen (a debugger, a viewer in the background) changes nothing."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from running import (
    ENDLESS,
    Watcher,
    assert_as_simulated,
    await_true,
    free_endpoint,
    settings,
    started,
)

LONG_S = 4.0
"""In which four times as much is sent as there is room for between a sender and a subscriber."""


@contextmanager
def frozen_subscriber(endpoint: str, mode: str) -> Iterator[subprocess.Popen[bytes]]:
    script = str(Path(__file__).with_name("frozen_subscriber.py"))
    with subprocess.Popen(
        [sys.executable, script, endpoint, mode], stdout=subprocess.PIPE
    ) as process:
        try:
            assert process.stdout is not None
            process.stdout.readline()
            yield process
        finally:
            process.kill()


def is_frozen(process: subprocess.Popen[bytes]) -> bool:
    pid, status = os.waitpid(process.pid, os.WUNTRACED | os.WNOHANG)
    assert not pid or os.WIFSTOPPED(status), "it ended"
    return bool(pid)


@pytest.mark.parametrize(("clock", "mode"), [("lockstep", "client"), ("realtime", "peer")])
def test_frozen_subscriber_changes_nothing(tmp_path: Path, clock: str, mode: str) -> None:
    endpoint = free_endpoint()
    patient = settings(
        clock=clock,
        link__plant_endpoint=endpoint,
        link__controller_endpoint=free_endpoint(),
        plant__command_timeout_ms=30_000.0,
    )
    with (
        frozen_subscriber(endpoint, mode) as stranger,
        started("run", "paper_arm", *ENDLESS, *patient, out=tmp_path / "run") as run,
    ):
        await_true(lambda: is_frozen(stranger), "it has heard something")
        with Watcher(endpoint) as watcher:
            watcher.await_time(0.0, run)
            come_s = watcher.last_stamp_ns * 1e-9 + LONG_S
            watcher.await_time(come_s, run)
        run.send(signal.SIGINT)
        ended = run.end()
        assert stranger.returncode is None
    assert (ended.code, ended.summary["faults"]) == (130, []), ended.output
    lost = ended.summary["recorder"]["lost_by_topic"].get("plant_truth", 0)
    skipped = ended.summary["recording"]["ticks_skipped"]
    assert len(ended.log.payloads["plant_truth"]) + lost + skipped >= round(1000 * come_s)
    if clock == "lockstep":  # in real time a busy machine may keep the recorder from its work
        assert ended.summary["recorder"]["lost"] == 0
        names = ("joint_states", "joint_commands", "plant_status", "plant_truth")
        assert_as_simulated(ended, come_s, tmp_path / "simulation", *names)
