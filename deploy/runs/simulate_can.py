"""A run over CAN in one process and in virtual time: master and drives, each on its thread."""

from __future__ import annotations

import threading
import uuid
from collections.abc import Callable
from pathlib import Path

from bus_schema.can.link import CanControllerLink
from bus_schema.can.session import open_can_bus
from bus_schema.link.in_process import InProcessBus, InProcessTelemetry
from bus_schema.runtime.clock import VirtualClock
from controller.control_loop import ControlLoop, reason_of
from deploy.processes.can_links import can_controller_link, can_plant_link
from deploy.scenario.scenario import Setup
from plant_emulator.drives.driven_arm import DrivenArm
from plant_emulator.plant_loop import PlantLoop


def run_over_can(
    setup: Setup,
    bus: InProcessBus,
    clock: VirtualClock,
    on_start: Callable[[PlantLoop], None] | None,
    can_log: Path | None,
) -> Exception | None:
    """Run a scenario over CAN; what stopped the controller, if anything did.

    Args:
        setup: the scenario.
        bus: takes all messages but those that go over CAN.
        clock: the plant's clock.
        on_start: called with the plant loop before it runs.
        can_log: file for the frames.
    """
    run, telemetry = setup.can_run(lockstep=True), InProcessTelemetry(bus)
    can = run.link.can
    if can.interface == "virtual":  # simulations in threads of one process must not meet
        can = can.model_copy(update={"channel": f"{can.resolved_channel}-{uuid.uuid4()}"})
    arm = setup.arm()
    assert isinstance(arm, DrivenArm)
    master_bus, drives_bus = open_can_bus(can), open_can_bus(can)
    link = can_controller_link(setup, run, master_bus, VirtualClock(), telemetry)
    loop = ControlLoop(setup.control_task(), link)
    plant_link = can_plant_link(
        setup, run, arm, drives_bus, clock, telemetry, can_log, await_recorder=False
    )
    plant = PlantLoop(setup.plant_task(lockstep=True), arm, plant_link, clock)
    if on_start is not None:
        on_start(plant)
    controller = _Controller(loop, link, telemetry)
    try:
        plant.warm_up()
        controller.start()
        plant_link.await_controller(run.link.connect_timeout_s, lambda: not controller.is_alive())
        plant.run()
        plant_link.await_recorded()
    finally:
        controller.stop()
        plant_link.close()
        link.close()
        arm.close()
    return controller.failure


class _Controller(threading.Thread):
    """The controller's thread.

    Attributes:
        failure: what stopped it, if anything did.
    """

    def __init__(
        self, loop: ControlLoop, link: CanControllerLink, telemetry: InProcessTelemetry
    ) -> None:
        super().__init__(daemon=True)
        self._loop, self._link, self._telemetry = loop, link, telemetry
        self._stop_requested = False
        self.failure: Exception | None = None

    def run(self) -> None:
        try:
            self._loop.warm_up()
            self._link.join(is_stop_requested=lambda: self._stop_requested)
        except Exception as error:  # noqa: BLE001 (whatever a law raises, the end is in order)
            self.failure = error
            self._loop.stop(reason_of(error))
        finally:
            self._loop.end()
            self._telemetry.controller_is_there = False

    def stop(self) -> None:
        """End it, if it has not ended by itself."""
        self._stop_requested = True
        if self.is_alive():
            self.join()
