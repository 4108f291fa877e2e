"""A kind of link from outside: one class and one entry in the table, and every command knows it."""

from __future__ import annotations

from pathlib import Path

import pytest

from bus_schema.configuration import ConfigurationError
from bus_schema.link.configuration import LinkConfiguration
from bus_schema.link.in_process import InProcessControllerLink, InProcessPlantLink
from bus_schema.link.interface import ControllerLink, PlantLink
from bus_schema.recording.mcap_log import read_log
from bus_schema.runtime.clock import Clock
from deploy.judge.run_data import RunData
from deploy.run.replay import replay
from deploy.run.simulate import simulate
from deploy.scenario.link_kinds.kind import LINK_KINDS, LinkKind, LinkRun, shared_bus
from deploy.scenario.scenario import load_setup
from plant_emulator.arm_plant import ArmPlant

LARGEST_COUNT = 40
SHORT = ["duration_s=0.05", "link.kind=loopback"]


class LoopbackPlantLink(InProcessPlantLink):
    """It counts states, and reports a fault once there were too many."""

    states = 0

    def send_state(self, state: bytes, status: bytes) -> None:
        self.states += 1
        super().send_state(state, status)

    def fault(self) -> str | None:
        return "the loopback is exhausted" if self.states >= LARGEST_COUNT else None

    def report(self) -> dict[str, object]:
        return {"loopback": {"states": self.states}}


class LoopbackKind(LinkKind[ArmPlant]):
    """``loopback``."""

    name = "loopback"
    simulated_as = "loopback"
    arm_type = ArmPlant
    no_link_faults = "it cannot be cut"

    def check(self, run: LinkRun) -> None:
        if run.link.playout_ms:
            raise ConfigurationError("link.playout_ms", run.link.playout_ms, "nothing is held back")

    def check_machine(self, link: LinkConfiguration, *, one_process: bool) -> None:
        if not one_process:
            raise ConfigurationError("link.kind", link.kind, "this machine has no loopback")

    def open_plant(self, run: LinkRun, arm: ArmPlant, clock: Clock) -> PlantLink:
        return LoopbackPlantLink(shared_bus(run))

    def open_controller(self, run: LinkRun) -> ControllerLink:
        return InProcessControllerLink(shared_bus(run))


@pytest.fixture(autouse=True)
def loopback(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(LINK_KINDS.shipped, "loopback", f"{__name__}:LoopbackKind")


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
