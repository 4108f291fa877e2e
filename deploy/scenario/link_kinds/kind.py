"""Interface of a kind of link: its properties, and how to open its two sides."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Generic, TypeVar

from bus_schema.arrays import Vector
from bus_schema.can.exchange import FrameExchange
from bus_schema.configuration import ConfigurationError
from bus_schema.drive_feedback import DriveGains
from bus_schema.link.agreement import Agreement
from bus_schema.link.configuration import LinkConfiguration
from bus_schema.link.in_process import InProcessBus, InProcessControllerLink, InProcessPlantLink
from bus_schema.link.interface import ControllerLink, PlantLink
from bus_schema.registry import Registry
from bus_schema.robot_description import RobotDescription
from bus_schema.runtime.clock import Clock, TickGrid
from plant_emulator.arm_plant import ArmPlant
from plant_emulator.configuration import PlantConfiguration

Arm = TypeVar("Arm", bound=ArmPlant)


@dataclass(frozen=True)
class LinkRun:
    """Inputs of a link for one run: what it connects, and its own resources.

    Attributes:
        robot: description of the arm.
        plant: section ``plant`` of the scenario.
        link: section ``link`` of the scenario.
        grid: ticks of the run.
        ticks: length of the run.
        lockstep: the plant waits for the reply to every state that is delivered.
        seed: seed of everything random on the link.
        takes_targets: the drives close their own loop, around targets in the commands.
        bus: bus of both sides inside one process; None between processes.
        frames: CAN bus of both sides inside one process; unused between processes.
        can_log: file for the frames of a CAN bus; None for no log.
        drive: gains of the drives' own loops; None if they follow torques alone.
        tuned_drive: gains to which drives are tuned, for any kind of target.
        agreement: values that the run's processes must agree on; None inside one process.
    """

    robot: RobotDescription
    plant: PlantConfiguration
    link: LinkConfiguration
    grid: TickGrid
    ticks: int
    lockstep: bool
    seed: int
    takes_targets: bool
    bus: InProcessBus | None = None
    frames: FrameExchange = field(default_factory=FrameExchange)
    can_log: Path | None = None
    drive: DriveGains | None = None
    tuned_drive: DriveGains | None = None
    agreement: Agreement | None = None


class LinkKind(ABC, Generic[Arm]):
    """A kind of link. Defaults are those of a network.

    Attributes:
        name: its name in a scenario.
        simulated_as: its name in the recording of a simulation.
        arm_type: class of the arm: with motor drives or without.
        logs_frames: whether its plant's side can write a log of frames.
        may_pin_loops: whether each loop may be bound to its own CPU.
        brings_plant_status: whether the controller gets the plant's status with each state.
        controller_leads: whether the controller may end a run in order, as the master of drives
            does.
        reaches_robots: whether it goes to robots with a controller of their own, besides drives.
        simulates_process_faults: whether a controller can be silenced in a simulation.
        no_link_faults: what is allowed instead of scheduled faults of messages, if the plant cannot
            change this link's messages; None if it can.
    """

    name: str
    simulated_as: str
    arm_type: type[Arm]
    logs_frames = False
    may_pin_loops = True
    brings_plant_status = True
    controller_leads = False
    reaches_robots = True
    simulates_process_faults = True
    no_link_faults: str | None = None

    def check(self, run: LinkRun) -> None:
        """Check that a scenario fits the link, independent of the machine.

        Raises:
            ConfigurationError: it does not.
        """

    def warnings(self, run: LinkRun, most_nm: Vector) -> list[str]:  # noqa: ARG002 (most have none)
        """Return warnings about accepted but suspicious settings, a sentence each.

        Args:
            run: the run.
            most_nm: the controller's largest torques, N m, shape (joints,).
        """
        return []

    def check_machine(self, link: LinkConfiguration, *, one_process: bool) -> None:
        """Check that this machine has the link's requirements, before anything starts.

        Args:
            link: section ``link`` of the scenario.
            one_process: both sides will be in this process.

        Raises:
            ConfigurationError: it does not.
        """

    def with_own_place(self, link: LinkConfiguration) -> LinkConfiguration:
        """Return the link at a place without other runs, unless the scenario gives its place."""
        return link

    def wire_rounding(
        self,
        run: LinkRun,  # noqa: ARG002 (for links that round)
    ) -> Callable[[Vector], Vector] | None:
        """Return torques as the wire rounds them, N m, shape (joints,); None if it does not."""
        return None

    @abstractmethod
    def open_plant(self, run: LinkRun, arm: Arm, clock: Clock) -> PlantLink:
        """Open the plant's side.

        Args:
            run: the run.
            arm: the arm; it gets drives if the link has them.
            clock: the plant's clock.

        Raises:
            BusError: the link cannot be opened.
        """

    @abstractmethod
    def open_controller(self, run: LinkRun) -> ControllerLink:
        """Open the controller's side.

        Raises:
            BusError: the link cannot be opened.
        """


class InProcessKind(LinkKind[ArmPlant]):
    """``in_process``: a message is a function call."""

    name = "in_process"
    simulated_as = "in_process"
    arm_type = ArmPlant

    def check_machine(self, link: LinkConfiguration, *, one_process: bool) -> None:
        if not one_process:
            others = " or ".join(name for name in LINK_KINDS if name != self.name)
            allowed = f"must be {others} for run; simulate runs in one process"
            raise ConfigurationError("link.kind", link.kind, allowed)

    def open_plant(self, run: LinkRun, arm: ArmPlant, clock: Clock) -> PlantLink:  # noqa: ARG002
        return InProcessPlantLink(shared_bus(run))

    def open_controller(self, run: LinkRun) -> ControllerLink:
        return InProcessControllerLink(shared_bus(run))


class ZenohKind(InProcessKind):
    """``zenoh``: between processes; simulations use ``in_process``."""

    name = "zenoh"

    def check_machine(self, link: LinkConfiguration, *, one_process: bool) -> None:
        """Do nothing: every machine has the requirements."""

    def open_plant(self, run: LinkRun, arm: ArmPlant, clock: Clock) -> PlantLink:
        if run.bus is not None:
            return super().open_plant(run, arm, clock)
        from bus_schema.zenoh.link import ZenohPlantLink  # simulations do without

        return ZenohPlantLink(run.link, clock, lockstep=run.lockstep, agreement=run.agreement)

    def open_controller(self, run: LinkRun) -> ControllerLink:
        if run.bus is not None:
            return super().open_controller(run)
        from bus_schema.zenoh.link import ZenohControllerLink

        return ZenohControllerLink(run.link, lossless=run.lockstep, agreement=run.agreement)


def shared_bus(run: LinkRun) -> InProcessBus:
    """Return the bus of a run in one process; see `check_machine` for other runs."""
    assert run.bus is not None
    return run.bus


LINK_KINDS: Registry[type[LinkKind[Any]]] = Registry(
    "link_kinds",
    "link.kind",
    LinkKind,
    {
        "zenoh": "deploy.scenario.link_kinds.kind:ZenohKind",
        "in_process": "deploy.scenario.link_kinds.kind:InProcessKind",
        "can": "deploy.scenario.link_kinds.can:CanKind",
    },
)
"""Each is imported when a scenario names it, as CAN's libraries are slow."""
