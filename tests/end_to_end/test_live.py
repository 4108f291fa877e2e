"""A watched run has the bits of an unwatched one, with any viewer and any stranger."""

from __future__ import annotations

import json
import os
import re
import signal
import socket
import sys
import tempfile
from contextlib import suppress
from pathlib import Path
from typing import Any

import pytest
from running import ENDLESS, assert_as_simulated, processes_of, settings, started

from tests.deploy.reports.live.watched import Events, get, place
from tests.security import issued_keys
from tests.waiting import HANG_S, await_true
from tests.warm_process import WarmProcess

LOCKSTEP = settings(clock="lockstep", link__connect_timeout_s=HANG_S)
LONG = [*ENDLESS, *LOCKSTEP]
LONG_OF_IIWA = [*LOCKSTEP, *settings(duration_s=3600.0)]
LINUX = pytest.mark.skipif(sys.platform != "linux", reason="reads /proc")


def sockets_of(pid: int) -> list[Path]:
    """Sockets by which a process of a live view hears others."""
    parents = (os.environ.get("XDG_RUNTIME_DIR") or "/tmp", tempfile.gettempdir(), "/tmp")
    places = {place for parent in parents for place in Path(parent).glob(f"funnel-hil-*/*-{pid}-*")}
    return sorted(places)


def page_of(process: WarmProcess) -> str:
    """Address of the page that a command tells of."""
    await_true(lambda: process.poll() is not None or "token=" in process.output(), "it has a page")
    found = re.search(r"http://\S+", process.output())
    assert found, process.output()
    return found[0]


def first_frame(page: str) -> dict[str, Any]:
    """The first frame of a plant that tracks that a client of the page gets to see."""
    events = Events(page)
    frame = next(frame for frame in events.frames() if frame["mode"] == "tracking")
    events.close()
    return frame


@LINUX
def test_flood_of_packets_and_frozen_viewer_change_nothing(tmp_path: Path) -> None:
    with started("run", "paper_arm", "--live", *LONG, out=tmp_path / "run") as run:
        first_frame(page_of(run.process))
        places = sockets_of(processes_of(run.folder)["recorder"])
        stranger = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        stranger.connect(str(*places))
        stranger.setblocking(False)
        with suppress(BlockingIOError):  # no reader
            for size in range(1, 3000):
                stranger.send(bytes([size % 251]) * size)
        run.send(signal.SIGSTOP, "viewer")
        ended, come_s = run.end_later(number=signal.SIGTERM)
    assert ended.summary["faults"] == [], ended.output
    assert ended.summary["recorder"]["lost"] == 0
    names = ("joint_states", "joint_commands", "plant_truth")
    assert_as_simulated(ended, come_s, tmp_path / "simulation", *names)
    assert not any(place.exists() for place in places)
    assert processes_of(tmp_path) == {}


@LINUX
def test_a_run_under_way_is_seen_from_outside_and_goes_on_when_the_viewer_is_gone(tmp_path):
    """Over TLS: `view` prints its address there too, by endpoint and by folder."""
    keys = issued_keys(tmp_path / "keys")
    secured = settings(link__security__enabled=True, link__security__folder=str(keys.path))
    arguments = [*LONG_OF_IIWA, *secured]
    with started("run", "iiwa", "--live", *arguments, out=tmp_path / "run") as run:
        page, endpoint = page_of(run.process), run.plant_endpoint()
        assert len(first_frame(page)["error"]) == 7
        source = json.loads(get(place(page, "run.json"))[2])["source"]
        assert source == f"at {endpoint}"  # which holds also when the run is over
        viewer = WarmProcess("view", endpoint)
        try:
            frame = first_frame(page_of(viewer))
            assert len(frame["error"]) == 7
        finally:
            viewer.terminate()
            assert viewer.wait() == 130, viewer.output()
        again = WarmProcess("view", run.folder)
        later = first_frame(page_of(again))
        assert later["time_s"] > frame["time_s"]
        run.send(signal.SIGTERM)
        run.end(130)
    assert again.wait() == 0, again.output()
    assert "the run is over" in again.output()
    assert processes_of(tmp_path) == {}


def test_viewer_without_a_recorder_says_so() -> None:
    viewer = WarmProcess("view", "tcp/127.0.0.1:9")
    assert viewer.wait() == 1
    assert "no recorder on this machine records a run at tcp/127.0.0.1:9" in viewer.output()
