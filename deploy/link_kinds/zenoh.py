"""A link over Zenoh between processes; it is not used within one process."""

from __future__ import annotations

from bus_schema.link.configuration import LinkConfiguration
from bus_schema.link.interface import ControllerLink, PlantLink
from bus_schema.runtime.clock import Clock
from bus_schema.zenoh.link import ZenohControllerLink, ZenohPlantLink
from deploy.link_kinds.kind import InProcessKind, LinkRun
from plant_emulator.arm_plant import ArmPlant


class ZenohKind(InProcessKind):
    """``zenoh``: between processes; simulations use ``in_process``."""

    name = "zenoh"

    def check_machine(self, link: LinkConfiguration, *, one_process: bool) -> None:
        """Do nothing: every machine has the requirements."""

    def open_plant(self, run: LinkRun, arm: ArmPlant, clock: Clock) -> PlantLink:
        if run.bus is not None:
            return super().open_plant(run, arm, clock)
        return ZenohPlantLink(run.link, clock, lockstep=run.lockstep, agreement=run.agreement)

    def open_controller(self, run: LinkRun) -> ControllerLink:
        if run.bus is not None:
            return super().open_controller(run)
        return ZenohControllerLink(run.link, lossless=run.lockstep, agreement=run.agreement)
