"""A link over CAN: motor drives between controller and joints."""

from __future__ import annotations

import secrets
import socket
from collections.abc import Callable
from functools import partial

from bus_schema.arrays import Vector
from bus_schema.can.codec import CanCodec, as_delivered
from bus_schema.can.exchange import ExchangeNode
from bus_schema.can.frame import CanBus
from bus_schema.can.frame_timing import check_cycle_fits
from bus_schema.can.link import CanControllerLink, CanRun
from bus_schema.can.medium import CandumpLog, CanMedium
from bus_schema.can.protocol import PROTOCOLS, DriveProtocol
from bus_schema.can.session import check_can_bus, open_can_bus
from bus_schema.can.survey import require_no_others
from bus_schema.configuration import ConfigurationError
from bus_schema.link.can_configuration import CanConfiguration
from bus_schema.link.channel_configuration import ChannelConfiguration
from bus_schema.link.configuration import LinkConfiguration
from bus_schema.link.in_process import InProcessNode
from bus_schema.link.interface import ControllerLink, PlantLink, Telemetry
from bus_schema.messages.topics import Role
from bus_schema.robot_description import RobotDescription
from bus_schema.runtime.clock import Clock, MonotonicClock, VirtualClock
from bus_schema.zenoh.link import open_telemetry
from deploy.scenario.link_kinds.kind import LinkKind, LinkRun
from plant_emulator.configuration import PlantConfiguration
from plant_emulator.drives.can_plant_link import CanPlantLink
from plant_emulator.drives.commissioning import build_bank, commission, drive_of
from plant_emulator.drives.drives_on_bus import DrivenArm, DrivesOnBus
from plant_emulator.drives.fault_plan import parse_fault

_KIND = ["link.kind"]
_PROTOCOL = [*_KIND, "link.can.protocol"]
"""Keys beside the one that an error names."""


class CanKind(LinkKind[DrivenArm]):
    """``can``: states and torques are frames; telemetry goes over Zenoh, or stays in the process.

    Loops are not bound to CPUs: canopen polls while another thread has to hand it the answers.
    """

    name = "can"
    simulated_as = "can"
    arm_type = DrivenArm
    logs_frames = True
    may_pin_loops = False
    brings_plant_status = False
    controller_leads = True
    reaches_robots = False
    simulates_process_faults = False
    no_link_faults = "without link.kind: can, for which link.can.faults has the faults of the bus"

    def check(self, run: LinkRun) -> None:
        can, robot = run.link.can, run.robot
        protocol = PROTOCOLS[can.protocol]()
        node_ids = check_drives(can, robot, run.plant, takes_targets=run.takes_targets)
        if run.takes_targets and not protocol.takes_targets:
            side = "plant" if run.plant.drive_feedback.enabled else "controller"
            allowed = f"false over CAN with {protocol.title}: these drives accept only torques"
            raise ConfigurationError(f"{side}.drive_feedback.enabled", True, allowed, _PROTOCOL)
        if delay_ms := run.plant.actuator.delay_ms:
            allowed = "must be 0 over CAN, where link.downlink.delay_ms delays the frames"
            raise ConfigurationError("plant.actuator.delay_ms", delay_ms, allowed, _KIND)
        check_cycle_fits(can, _codec(run).cycle, robot.joints, 1e9 / run.grid.period_ns)
        _check_delays(run, protocol)
        for text in can.faults.drives:
            try:
                parse_fault(text, node_ids)
            except ConfigurationError as error:
                raise ConfigurationError("link.can.faults.drives", text, error.allowed) from error

    def warnings(self, run: LinkRun, most_nm: Vector) -> list[str]:
        can = run.link.can
        return PROTOCOLS[can.protocol]().warnings(can, run.robot, most_nm)

    def check_machine(self, link: LinkConfiguration, *, one_process: bool) -> None:
        if link.can.interface == "virtual" and not one_process:
            allowed = (
                "reaches no other process: must be udp_multicast, socketcan or hardware for run;"
                " simulate runs in one process"
            )
            raise ConfigurationError("link.can.interface", "virtual", allowed, _KIND)
        check_can_bus(link.can)

    def with_own_place(self, link: LinkConfiguration) -> LinkConfiguration:
        can = link.can
        if not _may_choose_place(can):
            return link
        # Linux tells groups on one port not apart in every set-up: the port has to be free too.
        group = f"239.74.{secrets.randbelow(256)}.{1 + secrets.randbelow(254)}"
        place = {"channel": group, "port": _free_udp_port()}
        return link.model_copy(update={"can": can.model_copy(update=place)})

    def wire_rounding(self, run: LinkRun) -> Callable[[Vector], Vector]:
        return partial(as_delivered, _codec(run))

    def open_plant(self, run: LinkRun, arm: DrivenArm, clock: Clock) -> PlantLink:
        can, robot = run.link.can, run.robot
        node_ids = can.node_ids_of(robot.joints)
        bus, telemetry = _open_bus(run), _open_telemetry(run, Role.PLANT)
        log = None if run.can_log is None else CandumpLog(run.can_log, can.log_channel)
        plan = [parse_fault(text, node_ids) for text in can.faults.drives]
        build = partial(build_bank, can, robot, run.plant, polled=True, tuned=run.tuned_drive)
        medium = CanMedium(can, run.seed, log)
        drives = DrivesOnBus(bus, plan, build, medium, run.link.downlink.delay_ns)
        arm.attach(drives)
        return CanPlantLink(_can_run(run), drives, _codec(run), clock, telemetry)

    def open_controller(self, run: LinkRun) -> ControllerLink:
        can, bus, telemetry = run.link.can, _open_bus(run), _open_telemetry(run, Role.CONTROLLER)
        protocol = PROTOCOLS[can.protocol]()
        node_ids = protocol.node_ids(can, run.robot.joints)
        if may_have_others(can):
            require_no_others(bus, protocol, can, node_ids)
        master = protocol.master(bus, can, node_ids, _codec(run))
        clock: Clock = VirtualClock() if run.lockstep else MonotonicClock()
        link = partial(CanControllerLink, _can_run(run), master, bus, clock, telemetry)
        return link(bus.leave_turns) if isinstance(bus, ExchangeNode) else link()


def check_drives(
    can: CanConfiguration, robot: RobotDescription, plant: PlantConfiguration, *,
    takes_targets: bool,
) -> tuple[int, ...]:  # fmt: skip
    """Return the addresses of a scenario's drives, for any kind of link.

    Raises:
        ConfigurationError: the drives do not fit their protocol or the robot.
    """
    protocol, _ = PROTOCOLS[can.protocol](), drive_of(can.protocol)
    protocol.check(can, takes_targets=takes_targets)
    protocol.settings(can)
    _check_fd(can, protocol)
    return tuple(each.node_id for each in commission(can, robot, plant))


def _codec(run: LinkRun) -> CanCodec:
    protocol = PROTOCOLS[run.link.can.protocol]()
    return protocol.codec(run.link.can, run.robot, run.drive)


def _can_run(run: LinkRun) -> CanRun:
    return CanRun(run.robot.joint_names, run.link, run.grid, run.ticks, run.lockstep, run.drive)


def may_have_others(can: CanConfiguration) -> bool:
    """Whether drives that a scenario does not know may be on its bus."""
    return can.interface != "virtual" and not _may_choose_place(can)


def _may_choose_place(can: CanConfiguration) -> bool:
    """Whether a run gets a bus of its own: the scenario names none that others know."""
    return can.interface == "udp_multicast" and not {"channel", "port"} & can.model_fields_set


def _open_bus(run: LinkRun) -> CanBus:
    can = run.link.can
    # Simulations on one machine must not meet, and need no socket.
    if run.bus is not None and (can.interface == "virtual" or _may_choose_place(can)):
        return run.frames.join()
    return open_can_bus(run.link.can)


def _open_telemetry(run: LinkRun, role: Role) -> Telemetry:
    if run.bus is not None:
        return InProcessNode(run.bus, role)
    return open_telemetry(run.link, role, lossless=run.lockstep, agreement=run.agreement)


def _check_delays(run: LinkRun, protocol: DriveProtocol) -> None:
    """Check that messages are delayed at most, and only where time waits for them."""
    link, refusal = run.link, None
    if not run.lockstep:
        refusal = "without delays if clock is realtime"
    elif protocol.answers_torques:
        refusal = f"without delays with {protocol.title}, whose drives answer every frame"
    for name in ("uplink", "downlink"):
        given: ChannelConfiguration = getattr(link, name)
        shown = given.model_dump(exclude_defaults=True)
        if not given.is_constant:
            refusal = "delay_ms alone"
        if shown and refusal is not None:
            allowed = (
                f"must be {refusal}, with link.kind = can: link.can.bitrate and link.can.faults"
                " describe the bus"
            )
            raise ConfigurationError(f"link.{name}", shown, allowed, _PROTOCOL)
    if link.playout_ms:
        allowed = "must be left out with link.kind = can"
        raise ConfigurationError("link.playout_ms", link.playout_ms, allowed, _KIND)


def _check_fd(can: CanConfiguration, protocol: DriveProtocol) -> None:
    key = "link.can.fd_process_data"
    if can.fd_process_data and not protocol.has_fd_process_data:
        allowed = f"must be false with {protocol.title}"
        raise ConfigurationError(key, True, allowed, _PROTOCOL)
    if can.fd_process_data and not can.fd:
        allowed = f"must be true with {key} = true"
        raise ConfigurationError("link.can.fd", False, allowed, [*_KIND, key])


def _free_udp_port() -> int:
    """Return a free UDP port of this machine."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("", 0))
        port: int = probe.getsockname()[1]
        return port
