"""A link inside one process, for simulations."""

from __future__ import annotations

from bus_schema.configuration import ConfigurationError
from bus_schema.link.configuration import LinkConfiguration
from bus_schema.link.in_process import InProcessBus, InProcessControllerLink, InProcessPlantLink
from bus_schema.link.interface import ControllerLink, PlantLink
from bus_schema.runtime.clock import Clock
from deploy.link_kinds.kind import LinkKind, LinkRun
from deploy.link_kinds.table import LINK_KINDS
from plant_emulator.arm_plant import ArmPlant


class InProcessKind(LinkKind[ArmPlant]):
    """``in_process``: a message is a function call."""

    name = "in_process"
    simulated_as = "in_process"
    arm_type = ArmPlant
    draws_random_numbers = False

    def check_machine(self, link: LinkConfiguration, *, one_process: bool) -> None:
        if not one_process:
            others = " or ".join(name for name in LINK_KINDS.names if name != self.name)
            allowed = f"must be {others} for run; simulate runs in one process"
            raise ConfigurationError("link.kind", link.kind, allowed)

    def open_plant(self, run: LinkRun, arm: ArmPlant, clock: Clock) -> PlantLink:  # noqa: ARG002
        return InProcessPlantLink(shared_bus(run))

    def open_controller(self, run: LinkRun) -> ControllerLink:
        return InProcessControllerLink(shared_bus(run))


def shared_bus(run: LinkRun) -> InProcessBus:
    """The bus of a run in one process; without one there is no such run, see `check_machine`."""
    assert run.bus is not None
    return run.bus
