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

DURATION_S = 4.0
"""In which four times as much is sent as there is room for between a sender and a subscriber."""


@contextmanager
def frozen_subscriber(endpoint: str) -> Iterator[subprocess.Popen[bytes]]:
    script = str(Path(__file__).with_name("frozen_subscriber.py"))
    with subprocess.Popen([sys.executable, script, endpoint]) as process:
        try:
            yield process
        finally:
            process.kill()


def is_frozen(process: subprocess.Popen[bytes]) -> bool:
    pid, status = os.waitpid(process.pid, os.WUNTRACED | os.WNOHANG)
    assert not pid or os.WIFSTOPPED(status), "it ended"
    return bool(pid)


@pytest.mark.parametrize("clock", ["lockstep", "realtime"])
def test_frozen_subscriber_changes_nothing_and_the_recorder_has_everything(
    tmp_path: Path, clock: str
) -> None:
    endpoint, so_long = free_endpoint(), settings(duration_s=DURATION_S)
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
    assert ended.summary["recorder"]["lost"] == 0
    assert len(ended.log.payloads["plant_truth"]) >= 1000 * DURATION_S
    if clock == "lockstep":
        alone = funnel_hil_here("simulate", "paper_arm", *so_long, out=tmp_path / "simulation")
        assert ended.digest == alone.digest
