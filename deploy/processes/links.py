"""Links of a scenario's kind, for controller and plant as processes of their own.

What only a link over CAN needs is imported where there is one: its libraries take their time.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Protocol

from bus_schema.configuration import ConfigurationError
from bus_schema.link.interface import PlantLink
from bus_schema.messages.topics import Role
from bus_schema.runtime.clock import Clock
from bus_schema.zenoh.link import ZenohControllerLink, ZenohPlantLink
from deploy.scenario.scenario import Setup
from deploy.scenario.yaml_files import ScenarioError
from plant_emulator.arm.arm_plant import ArmPlant
from plant_emulator.drives.driven_arm import DrivenArm

if TYPE_CHECKING:
    from bus_schema.can.link import CanControllerLink


class RecordedPlantLink(PlantLink, Protocol):
    """The plant's side of a link between processes."""

    def await_recorded(self) -> None:
        """After an `ENDED` event: wait until a recorder, if there is one, has everything."""
        ...


def check_link(setup: Setup, *, one_process: bool) -> None:
    """Check that this machine has what the scenario's link needs, before anything starts.

    Raises:
        ScenarioError: it has not.
    """
    link = setup.scenario.link
    try:
        if link.kind == "in_process" and not one_process:
            raise ConfigurationError(
                "link.kind", link.kind, "must be zenoh or can for run; simulate runs in one process"
            )
        if link.kind == "can":
            if link.can.interface == "virtual" and not one_process:
                raise ConfigurationError(
                    "link.can.interface", "virtual",
                    "reaches no other process: must be udp_multicast, socketcan or hardware for"
                    " run; simulate runs in one process",
                )  # fmt: skip
            from bus_schema.can.session import check_can_bus

            check_can_bus(link.can)
    except ConfigurationError as error:
        raise ScenarioError(f"{setup.source}: {error}") from error


def require_keys(setup: Setup, *roles: Role) -> None:
    """Bad keys are bad input, told before anything starts.

    Raises:
        ScenarioError: as `check_keys`.
    """
    security = setup.scenario.link.security
    if security.enabled:
        from deploy.processes.keys import check_keys  # needs libraries that no other run does

        check_keys(security.keys, roles)


def open_plant_link(
    setup: Setup, arm: ArmPlant, clock: Clock, *, await_recorder: bool, can_log: Path | None
) -> RecordedPlantLink:
    """The plant's side of the scenario's link.

    Args:
        setup: the scenario.
        arm: the arm, which gets its drives where the link has drives.
        clock: the plant's clock.
        await_recorder: do not start without a recorder.
        can_log: file for the frames of a CAN bus.

    Raises:
        BusError: the link cannot be opened.
    """
    link, lockstep = setup.scenario.link, setup.scenario.clock == "lockstep"
    if not isinstance(arm, DrivenArm):
        return ZenohPlantLink(link, clock, lossless=lockstep, await_recorder=await_recorder)
    from deploy.processes.can_links import open_can_plant_link

    return open_can_plant_link(setup, arm, clock, can_log, await_recorder=await_recorder)


def open_controller_link(setup: Setup) -> ZenohControllerLink | CanControllerLink:
    """The controller's side of the scenario's link.

    Raises:
        BusError: the link cannot be opened.
    """
    link, lockstep = setup.scenario.link, setup.scenario.clock == "lockstep"
    if link.kind != "can":
        return ZenohControllerLink(link, lossless=lockstep)
    from deploy.processes.can_links import open_can_controller_link

    return open_can_controller_link(setup)
