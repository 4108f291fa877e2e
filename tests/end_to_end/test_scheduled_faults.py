"""Scheduled faults in runs with real processes: real signals, and the bits of the simulation."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from running import Finished, funnel_hil_here, processes_of, settings

from bus_schema.messages.run_event import EventKind
from bus_schema.messages.topics import PLANT_TRUTH
from bus_schema.recording.mcap_log import read_log
from bus_schema.runtime.modes import Mode
from deploy.run.simulate import simulate
from deploy.scenario.scenario import load_setup
from scripts.experiments.fault_table import to_safe_state_ms


def run(tmp_path: Path, name: str, **values: object) -> Finished:
    """Run a shipped fault; no process is left over, and the recording has the time of the fault."""
    ended = funnel_hil_here(
        "run", f"faults/{name}", *settings(**values), out=tmp_path / "run", code=1
    )
    assert processes_of(ended.folder) == {}
    assert "Traceback" not in ended.output
    reported = [event.stamp_ns for event in ended.data.events if event.kind == EventKind.INJECTED]
    assert all(
        at_ns >= 1_000_000_000 for at_ns in reported
    )  # in real time a busy plant comes later
    return ended


@pytest.mark.parametrize("name", ["controller_killed", "plant_clock_step"])
def test_lockstep_gives_the_bits_of_the_simulation(tmp_path: Path, name: str) -> None:
    disrupted = run(tmp_path, name, clock="lockstep")
    simulated = simulate(load_setup(f"faults/{name}")).data()
    assert disrupted.digest == simulated.digest
    assert to_safe_state_ms(disrupted.data) == to_safe_state_ms(simulated) == 200.0


def test_recorder_that_is_restarted_goes_on_in_another_file_each_time(tmp_path: Path) -> None:
    restarts = [
        {"kind": "process_restarted", "target": "recorder", "at_s": at_s, "for_s": 0.2}
        for at_s in (1.0, 1.5)
    ]
    disrupted = run(tmp_path, "recorder_restarted", clock="lockstep", duration_s=3, faults=restarts)
    faults, killed = disrupted.summary["faults"], "the recorder was killed by SIGKILL"
    assert faults[0] == killed
    assert [fault for fault in faults if "killed" in fault] == [killed] * 2
    assert not disrupted.data.complete
    second = read_log(disrupted.folder / "run-2.partial.mcap")
    assert not second.complete
    last = read_log(disrupted.folder / "run-3.mcap")
    assert last.complete
    assert last.payloads[PLANT_TRUTH.name]


def test_controller_that_is_restarted_does_not_move_a_stopped_arm(tmp_path: Path) -> None:
    disrupted = run(tmp_path, "controller_restarted", clock="lockstep")
    truth = disrupted.data.tables[PLANT_TRUTH.name]
    assert to_safe_state_ms(disrupted.data) == 200.0
    assert set(truth["mode"][1500:]) <= {Mode.STOPPING, Mode.FAULT}
    assert np.abs(truth["velocity"][1500:]).max() < 1e-3
    senders = [event.source for event in disrupted.data.events if event.kind == EventKind.ENDED]
    assert "controller" in senders  # the newcomer was there to the end
