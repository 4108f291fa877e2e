"""Runs whose messages really take their time: a relay between controller and plant."""

from __future__ import annotations

import json
import re
import signal
from pathlib import Path

from running import Watcher, funnel_hil_here, processes_of, settings, started

from bus_schema.messages.topics import CONTROL_STATUS, PLANT_TRUTH
from deploy.judge.findings.link_delays import measured_link
from deploy.judge.run_data import RunData

ROUND_TRIP_MS = 4
PATIENT = settings(plant__command_timeout_ms=20_000)  # a busy machine may hold up a loop
DELAYED = ["run", "paper_arm", "--real-delay", str(ROUND_TRIP_MS), *PATIENT]


def least_round_trip_ms(data: RunData) -> float:
    """Of all commands that arrived."""
    round_trips_ns = data.tables[PLANT_TRUTH.name]["round_trip_ns"]
    return float(round_trips_ns[round_trips_ns >= 0].min()) * 1e-6


def test_no_command_comes_back_sooner_than_the_relay_lets_it(tmp_path: Path) -> None:
    run = funnel_hil_here(*DELAYED, *settings(duration_s=1), out=tmp_path / "run")
    assert run.summary["completed"]
    assert least_round_trip_ms(run.data) >= ROUND_TRIP_MS
    manifest = json.loads((run.folder / "manifest.json").read_text())
    assert manifest["real_delay"]["round_trip_ms"] == ROUND_TRIP_MS
    assert manifest["real_delay"]["chunks"] > 0
    assert manifest["real_delay"]["lateness_us"]["max"] >= 0
    assert run.data.setup.scenario.link.deadline_ms == 1 + ROUND_TRIP_MS
    delays_ms = {way: found.delays_ms for way, found in measured_link(run.data).items()}
    assert delays_ms["uplink"].min() >= ROUND_TRIP_MS / 2
    assert len(delays_ms["uplink"]) == run.data.tables[CONTROL_STATUS.name].size
    assert delays_ms["downlink"].size
    assert re.search(r"uplink: [\d,]+ messages in [\d.]+ s, lost \d+ ", run.output)


def test_run_ends_with_its_relay_and_names_it(tmp_path: Path) -> None:
    with started(*DELAYED, *settings(duration_s=60), out=tmp_path / "run") as run:
        with Watcher(run.plant_endpoint()) as watcher:
            watcher.await_time(0.3, run)
            run.send(signal.SIGTERM, "relay")
            ended = run.end(1)
        assert processes_of(run.folder) == {}
    assert ended.summary["faults"][0] == "the relay ended before the run did"
    assert not ended.summary["completed"]
