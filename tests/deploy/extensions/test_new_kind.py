"""A kind of link of a package: every command knows it."""

from __future__ import annotations

from pathlib import Path

import pytest

from bus_schema.recording.mcap_log import read_log
from deploy.judge.run_data import RunData
from deploy.run.replay import replay
from deploy.run.simulate import simulate
from deploy.scenario.scenario import load_setup

pytestmark = pytest.mark.usefixtures("example_package")
SHORT = ["duration_s=0.05", "link.kind=loopback"]


def events(run: RunData) -> list[str]:
    return [event.detail for event in run.events]


def test_scenario_runs_over_it_and_replays(tmp_path: Path) -> None:
    short = ["duration_s=0.03", "link.kind=loopback"]
    simulation = simulate(load_setup("paper_arm", short))
    run = simulation.data()
    assert run.faults() == []
    assert run.link == "loopback"
    assert any('"loopback": {"states": 30}' in detail for detail in events(run))
    in_process = simulate(load_setup("paper_arm", [*short, "link.kind=in_process"]))
    assert run.digest == in_process.data().digest
    simulation.write_log(tmp_path / "run.mcap")
    assert replay(simulation.setup, read_log(tmp_path / "run.mcap")).is_identical


def test_fault_that_it_reports_ends_the_run_by_its_name() -> None:
    run = simulate(load_setup("paper_arm", SHORT)).data()
    assert run.faults() == ["plant at 0.039 s: the loopback is exhausted"]


def test_commands_ask_it_whether_the_machine_will_do(funnel_hil, nothing_starts) -> None:
    words = [word for value in SHORT for word in ("--set", value)]
    output = funnel_hil.output("run", "paper_arm", *words, code=2)
    assert "link.kind = 'loopback': this machine has no loopback" in output
