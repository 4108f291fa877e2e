"""What everything else has to know of a kind of link, and how its two sides are opened."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Generic, TypeVar

from bus_schema.arrays import Vector
from bus_schema.configuration import ConfigurationError
from bus_schema.drive_feedback import DriveGains
from bus_schema.link.agreement import Agreement
from bus_schema.link.configuration import LinkConfiguration
from bus_schema.link.in_process import InProcessBus, InProcessControllerLink, InProcessPlantLink
from bus_schema.link.interface import ControllerLink, PlantLink
from bus_schema.registry import Registry
from bus_schema.runtime.clock import Clock
from plant_emulator.arm_plant import ArmPlant
from plant_emulator.plant_task import PlantTask

Arm = TypeVar("Arm", bound=ArmPlant)


@dataclass(frozen=True)
class LinkRun(PlantTask):
    """What a link has to know of the run that goes over it: the plant's task, and its own means.

    Attributes:
        bus: what both sides share inside one process; None between processes.
        can_log: file for the frames of a CAN bus; None for no log.
        drive: gains of the loops that the drives close; None where they take torques alone.
        agreement: what the processes of the run must agree on; None inside one process.
    """

    bus: InProcessBus | None = None
    can_log: Path | None = None
    drive: DriveGains | None = None
    agreement: Agreement | None = None


class LinkKind(ABC, Generic[Arm]):
    """A kind of link. What it does not say otherwise is as it is over a network.

    Attributes:
        name: its name in a scenario.
        simulated_as: what the recording of a simulation calls it.
        arm_type: the arm behind it: with motor drives or without.
        logs_frames: whether its plant's side can write a log of frames.
        may_pin_loops: whether each loop may be bound to a CPU of its own.
        draws_random_numbers: whether the link itself does, in a simulation.
        brings_plant_status: whether the controller gets the plant's status with each state.
        controller_leads: whether a run ends in order when the controller ends it, as the master of
            drives does.
        simulates_process_faults: whether a controller can be silenced in a simulation.
        no_link_faults: what is allowed in place of scheduled faults of messages, where there are
            none that the plant could change; None where there are.
    """

    name: str
    simulated_as: str
    arm_type: type[Arm]
    logs_frames = False
    may_pin_loops = True
    draws_random_numbers = True
    brings_plant_status = True
    controller_leads = False
    simulates_process_faults = True
    no_link_faults: str | None = None

    def check(self, run: LinkRun) -> None:
        """Check that a scenario fits the link, whatever the machine has.

        Raises:
            ConfigurationError: it does not.
        """

    def oddities(self, run: LinkRun, most_nm: Vector) -> list[str]:  # noqa: ARG002 (most have none)
        """A sentence for each thing that is taken, but that may not be what was meant.

        Args:
            run: the run.
            most_nm: the largest torques that the controller may give, N m, shape (joints,).
        """
        return []

    def check_machine(self, link: LinkConfiguration, *, one_process: bool) -> None:
        """Check that this machine has what the link needs, before anything starts.

        Args:
            link: section ``link`` of the scenario.
            one_process: both sides will be in this process.

        Raises:
            ConfigurationError: it has not.
        """

    def with_own_place(self, link: LinkConfiguration) -> LinkConfiguration:
        """The link where no other run meets it, as far as the scenario leaves open where it is."""
        return link

    def wire_rounding(
        self,
        run: LinkRun,  # noqa: ARG002 (for links that round)
    ) -> Callable[[Vector], Vector] | None:
        """What the wire makes of torques, N m, shape (joints,); None if they arrive as sent."""
        return None

    @abstractmethod
    def open_plant(self, run: LinkRun, arm: Arm, clock: Clock) -> PlantLink:
        """The plant's side.

        Args:
            run: the run.
            arm: the arm, which gets its drives where the link has drives.
            clock: the plant's clock.

        Raises:
            BusError: the link cannot be opened.
        """

    @abstractmethod
    def open_controller(self, run: LinkRun) -> ControllerLink:
        """The controller's side.

        Raises:
            BusError: the link cannot be opened.
        """


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


LINK_KINDS: Registry[LinkKind[Any]] = Registry(
    "link.kind",
    {
        "zenoh": "deploy.link_kinds.zenoh:ZenohKind",
        "in_process": "deploy.link_kinds.kind:InProcessKind",
        "can": "deploy.link_kinds.can:CanKind",
    },
)
"""Each is imported when a scenario names it: CAN's libraries are slow. A new one is a line here."""
