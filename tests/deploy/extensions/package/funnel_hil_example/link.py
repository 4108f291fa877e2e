"""A kind of link: within one process, and it wears out."""

from __future__ import annotations

from bus_schema.configuration import ConfigurationError
from bus_schema.link.configuration import LinkConfiguration
from bus_schema.link.in_process import InProcessControllerLink, InProcessPlantLink
from bus_schema.link.interface import ControllerLink, PlantLink
from bus_schema.runtime.clock import Clock
from deploy.scenario.link_kinds.kind import LinkKind, LinkRun, shared_bus
from plant_emulator.arm_plant import ArmPlant

LARGEST_COUNT = 40


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
