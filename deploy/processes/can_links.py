"""Links over CAN: for controller and plant as processes of their own, or in one."""

from __future__ import annotations

from pathlib import Path

from bus_schema.can.can_run import CanRun
from bus_schema.can.candump import CandumpLog
from bus_schema.can.cansimple_codec import CanSimpleCodec
from bus_schema.can.cansimple_master import CanSimpleMaster
from bus_schema.can.cia402_codec import Cia402Codec
from bus_schema.can.cia402_master import Cia402Master
from bus_schema.can.codec import build_codec
from bus_schema.can.frame import CanBus
from bus_schema.can.link import CanControllerLink
from bus_schema.can.master import CanMaster
from bus_schema.can.medium import CanMedium
from bus_schema.can.session import open_can_bus
from bus_schema.messages.topics import Role
from bus_schema.runtime.clock import Clock, MonotonicClock, VirtualClock
from bus_schema.zenoh.telemetry import Telemetry, ZenohTelemetry
from deploy.scenario.scenario import Setup
from plant_emulator.drives.can_plant_link import CanPlantLink
from plant_emulator.drives.commissioning import build_bank
from plant_emulator.drives.driven_arm import DrivenArm
from plant_emulator.drives.drives_on_bus import DrivesOnBus
from plant_emulator.drives.fault_plan import parse_fault


def open_can_plant_link(
    setup: Setup, arm: DrivenArm, clock: Clock, can_log: Path | None, *, await_recorder: bool
) -> CanPlantLink:
    """The plant's side of a scenario's link; the arguments are those of `open_plant_link`.

    Raises:
        BusError: the link cannot be opened.
    """
    link, lockstep = setup.scenario.link, setup.scenario.clock == "lockstep"
    bus = open_can_bus(link.can)
    telemetry = ZenohTelemetry(link, Role.PLANT, lossless=lockstep)
    run = setup.can_run(lockstep=lockstep)
    return can_plant_link(
        setup, run, arm, bus, clock, telemetry, can_log, await_recorder=await_recorder
    )


def open_can_controller_link(setup: Setup) -> CanControllerLink:
    """The controller's side of a scenario's link.

    Raises:
        BusError: the link cannot be opened.
    """
    link, lockstep = setup.scenario.link, setup.scenario.clock == "lockstep"
    bus = open_can_bus(link.can)
    telemetry = ZenohTelemetry(link, Role.CONTROLLER, lossless=lockstep)
    clock: Clock = VirtualClock() if lockstep else MonotonicClock()
    return can_controller_link(setup, setup.can_run(lockstep=lockstep), bus, clock, telemetry)


def can_plant_link(
    setup: Setup,
    run: CanRun,
    arm: DrivenArm,
    bus: CanBus,
    clock: Clock,
    telemetry: Telemetry,
    can_log: Path | None,
    *,
    await_recorder: bool,
) -> CanPlantLink:
    """The plant's side of a link over CAN on a bus that is open; the arm gets its drives."""
    can, robot = run.link.can, setup.robot
    log = None if can_log is None else CandumpLog(can_log, can.resolved_channel)
    node_ids = can.node_ids_of(robot.joints)
    drives = DrivesOnBus(
        bus,
        [parse_fault(text, node_ids) for text in can.faults.drives],
        lambda send: build_bank(can, robot, setup.scenario.plant, send, polled=True),
        CanMedium(can, setup.scenario.seed),
        log,
    )
    arm.attach(drives.bank)
    codec = build_codec(can, robot)
    return CanPlantLink(run, drives, codec, clock, telemetry, await_recorder=await_recorder)


def can_controller_link(
    setup: Setup, run: CanRun, bus: CanBus, clock: Clock, telemetry: Telemetry
) -> CanControllerLink:
    """The controller's side of a link over CAN on a bus that is open."""
    return CanControllerLink(run, _build_master(setup, bus), bus, clock, telemetry)


def _build_master(setup: Setup, bus: CanBus) -> CanMaster:
    can, robot = setup.scenario.link.can, setup.robot
    node_ids, codec = can.node_ids_of(robot.joints), build_codec(can, robot)
    if isinstance(codec, CanSimpleCodec):
        return CanSimpleMaster(bus, can, node_ids, codec)
    assert isinstance(codec, Cia402Codec)
    return Cia402Master(bus, can, node_ids, codec)
