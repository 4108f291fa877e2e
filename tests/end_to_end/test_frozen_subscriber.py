"""A foreign subscriber that is frozen (a debugger, a viewer in the background) changes nothing."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from running import await_true, free_endpoint, funnel_hil_here, settings, started

DURATION_S = {"realtime": 6.0, "lockstep": 20.0}
"""In 4 s four times as much is sent as there is room for between a sender and a subscriber; in
lockstep they are over in a second of wall time, in which a slow machine brings nobody together."""


@contextmanager
def frozen_subscriber(endpoint: str) -> Iterator[subprocess.Popen[bytes]]:
    script = str(Path(__file__).with_name("frozen_subscriber.py"))
    with subprocess.Popen([sys.executable, script, endpoint], stdout=subprocess.PIPE) as process:
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


@pytest.mark.parametrize("clock", ["lockstep", "realtime"])
def test_frozen_subscriber_changes_nothing(tmp_path: Path, clock: str) -> None:
    endpoint, duration_s = free_endpoint(), DURATION_S[clock]
    so_long = settings(duration_s=duration_s)
    patient = settings(
        clock=clock,
        link__plant_endpoint=endpoint,
        link__controller_endpoint=free_endpoint(),
        plant__command_timeout_ms=30_000.0,
    )
    with (
        frozen_subscriber(endpoint) as stranger,
        started("run", "paper_arm", *so_long, *patient, out=tmp_path / "run") as run,
    ):
        await_true(lambda: is_frozen(stranger), "it has heard something")
        ended = run.end()
        assert stranger.returncode is None
    assert (ended.code, ended.summary["faults"]) == (0, []), ended.output
    lost = ended.summary["recorder"]["lost_by_topic"].get("plant_truth", 0)
    assert len(ended.log.payloads["plant_truth"]) + lost >= 1000 * duration_s
    if clock == "lockstep":  # in real time a busy machine may keep the recorder from its work
        assert ended.summary["recorder"]["lost"] == 0
        alone = funnel_hil_here("simulate", "paper_arm", *so_long, out=tmp_path / "simulation")
        assert ended.digest == alone.digest
