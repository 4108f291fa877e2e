"""The command `drives`: emulates motor drives on a CAN bus, without controller and recorder."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import closing
from functools import partial
from typing import Annotated

import typer

from bus_schema.can.frame import CanBus, CanFrame
from bus_schema.can.medium import CanMedium
from bus_schema.can.protocol import PROTOCOLS
from bus_schema.can.session import open_can_bus
from bus_schema.can.survey import require_no_others
from bus_schema.configuration import ConfigurationError
from bus_schema.errors import BusError
from bus_schema.runtime.clock import Clock, MonotonicClock
from deploy.cli.parts.common import say_warnings
from deploy.cli.parts.options import Overrides, ScenarioArgument, finite
from deploy.run.console import Console
from deploy.run.exit_codes import FAULT, FINISHED, INTERRUPTED
from deploy.run.stop_signals import on_stop
from deploy.scenario.link_kinds.can import check_drives, may_have_others
from deploy.scenario.scenario import load_setup
from deploy.scenario.setup import Setup
from deploy.scenario.yaml_files import ScenarioError, naming
from plant_emulator.drives.commissioning import build_bank
from plant_emulator.drives.drive_rig import DriveRig
from plant_emulator.drives.drives_on_bus import DrivenArm, DrivesOnBus
from plant_emulator.drives.fault_plan import PlannedFault, parse_fault

Duration = Annotated[
    float | None,
    typer.Option(
        "--duration", metavar="S", min=0.001, callback=finite, help="Stop after this time."
    ),
]
Verbose = Annotated[bool, typer.Option("--verbose", "-v", help="Decode every frame.")]
Faults = Annotated[
    list[str] | None,
    typer.Option(
        "--fault",
        metavar="KIND:NODE@TIME[+DURATION]",
        help="Let something go wrong, such as drive:2@3s or silent:1@500ms+2s; repeatable. Kinds:"
        " drive, silent, encoder, encoder-frozen, over-temperature.",
    ),
]

_MOST_NAMED = 20


def drives(
    scenario: ScenarioArgument = "paper_arm",
    overrides: Overrides = None,
    duration_s: Duration = None,
    verbose: Verbose = False,
    faults: Faults = None,
) -> None:
    """Emulate the arm's motor drives on a CAN bus, with simulated physics, for any driver code."""
    setup = load_setup(scenario, overrides or [])
    say_warnings(setup)
    can, plant = setup.scenario.link.can, setup.scenario.plant
    with naming(setup.origin):
        node_ids = check_drives(can, setup.robot, plant, takes_targets=False)
    try:
        plan = [parse_fault(text, node_ids) for text in faults or []]
    except ConfigurationError as error:
        raise ScenarioError(str(error)) from error
    with naming(setup.origin):
        bus = open_can_bus(can)
    with closing(bus):
        if may_have_others(can):
            _require_empty(bus, setup)
        raise typer.Exit(_serve(setup, bus, plan, duration_s, verbose=verbose))


def _require_empty(bus: CanBus, setup: Setup) -> None:
    can = setup.scenario.link.can
    try:
        require_no_others(bus, PROTOCOLS[can.protocol](), can, ())
    except BusError as error:
        raise ScenarioError(str(error)) from error


def _serve(
    setup: Setup, bus: CanBus, plan: list[PlannedFault], duration_s: float | None, *, verbose: bool
) -> int:
    """Run the emulated drives until they stop. Returns the exit code."""
    clock = MonotonicClock()
    monitor = BusMonitor(bus, clock, verbose=verbose)
    can, robot, plant = setup.scenario.link.can, setup.robot, setup.scenario.plant
    build = partial(build_bank, can, robot, plant, tuned=setup.tuned_drive)
    with naming(setup.origin):
        drives = DrivesOnBus(monitor, plan, build, CanMedium(can, setup.scenario.seed))
    monitor.describe = drives.bank.describe
    arm = setup.arm_of_type(DrivenArm)
    rig = DriveRig(arm, drives, clock, setup.grid, monitor.print)
    on_stop(rig.request_stop)
    clock.start()
    nodes = ", ".join(str(each) for each in can.node_ids_of(robot.joints))
    place = f"{can.interface} {can.resolved_channel}"
    if can.interface == "udp_multicast":
        place += f", port {can.port}"
    place += ", in frames of CAN FD" * can.fd_process_data
    monitor.print(f"{can.protocol} drives {nodes} on {place}")
    ticks = None if duration_s is None else round(duration_s * 1e9 / setup.grid.period_ns)
    try:
        rig.run(ticks)
    except BusError as error:
        monitor.print(str(error))
        return FAULT
    finally:
        arm.close()
    skipped = f", {rig.skipped} of {rig.ticks} ticks late" * bool(rig.skipped)
    rejected = dict(drives.bank.rejections.counts) or "none"
    dropped = f", {count} dropped by the system" if (count := monitor.dropped()) else ""
    monitor.print(
        f"{monitor.received} frames received{dropped}, {monitor.sent} sent, rejected:"
        f" {rejected}{skipped}"
    )
    return INTERRUPTED if ticks is not None and rig.ticks < ticks else FINISHED


class BusMonitor(CanBus):
    """A bus that prints the frames on it, or the first one of each identifier that it receives.

    Of these it prints only a limited number: a scan for nodes tries hundreds of identifiers.

    Args:
        bus: the bus itself.
        clock: time of the printed lines.
        verbose: print all frames, in both directions.

    Attributes:
        describe: returns the meaning of a frame.
        received: number of received frames.
        sent: number of frames that the drives sent.
    """

    describe: Callable[[CanFrame], str]

    def __init__(self, bus: CanBus, clock: Clock, *, verbose: bool) -> None:
        self._bus, self._clock, self._verbose = bus, clock, verbose
        self._console = Console(highlight=False, markup=False, soft_wrap=True)
        self._identifiers: set[int] = set()
        self.received = self.sent = 0

    def send(self, frame: CanFrame) -> None:
        self._bus.send(frame)
        self.sent += 1
        if self._verbose:
            self._show("sent", frame)

    def receive(self, timeout_s: float) -> CanFrame | None:
        frame = self._bus.receive(timeout_s)
        if frame is None:
            return None
        self.received += 1
        is_first = frame.identifier not in self._identifiers
        self._identifiers.add(frame.identifier)
        if self._verbose or (is_first and len(self._identifiers) <= _MOST_NAMED):
            self._show("received", frame)
        elif is_first and len(self._identifiers) == _MOST_NAMED + 1:
            self.print("more identifiers were received; --verbose shows them")
        return frame

    def dropped(self) -> int | None:
        return self._bus.dropped()

    def close(self) -> None:
        self._bus.close()

    def print(self, sentence: str) -> None:
        """Print an event with its time."""
        self._console.print(f"{self._clock.now_ns() * 1e-9:9.4f}  {sentence}")

    def _show(self, direction: str, frame: CanFrame) -> None:
        data = "remote" if frame.is_remote else frame.data.hex(" ")
        text = self.describe(frame)
        self.print(f"{direction:8} {frame.identifier:03X} {data:<23}  {text}")
