"""The robot's own controller on the emulated arm: cycles of an interface, between physics steps."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from bus_schema.arrays import Matrix, Vector
from bus_schema.runtime.clock import TickGrid
from plant_emulator.arm.delay_line import NEVER, DriveCommand
from plant_emulator.interfaces.configuration import InterfaceConfiguration
from plant_emulator.interfaces.interface import FreeTorque, Motion, Reflex, RobotInterface
from plant_emulator.interfaces.settings import TORQUE

TorquesAlong = Callable[[Vector, Vector, Vector], Vector]
"""Torques, N m, for positions, velocities and accelerations, all of shape (joints,)."""


class RobotController:
    """Turns targets that arrive into the commands of drives, at its own rate.

    The controller knows the arm: torques of the planned motion go ahead to the drives, whose own
    loops correct what is left.

    Args:
        configuration: section ``plant.interface``.
        torques_along: inverse dynamics of the arm, as its own controller knows it.
        grid: physics steps of the run.
        interface: moves the arm; by default what the section says.

    Attributes:
        next_due: number of the physics step at which the next cycle begins.
    """

    def __init__(
        self, configuration: InterfaceConfiguration, torques_along: TorquesAlong, grid: TickGrid,
        interface: RobotInterface | None = None,
    ) -> None:  # fmt: skip
        self._interface = configuration.build() if interface is None else interface
        self._torques_along = torques_along
        self._takes_torque = configuration.takes == TORQUE
        self._knows_arm = configuration.settings.knows_arm
        self._period_s, self._phase_s = configuration.true_period_s, 1e-3 * configuration.phase_ms
        self._grid, self._cycles = grid, 0
        self._target: Matrix | None = None
        self.next_due = NEVER

    @property
    def reflex(self) -> Reflex | None:
        """The stop that the robot has decided; None while it moves."""
        return self._interface.reflex

    def start(self, position_rad: Vector, number: int) -> None:
        """Begin at rest at a position, with the first cycle at or after a physics step."""
        self._interface.start(position_rad)
        now_s = number * self._grid.substep_s
        self._cycles = max(0, math.ceil((now_s - self._phase_s) / self._period_s - 1e-9))
        self._schedule()

    def receive(self, torque_nm: Vector, target: Matrix | None) -> None:
        """Note what has arrived; the next cycle reads the newest."""
        if self._takes_torque:
            self._target = torque_nm[None].copy()
        elif target is not None:
            self._target = target.copy()

    def cycle(self, measured: Matrix) -> DriveCommand:
        """Return what the drives are told at this cycle."""
        target, self._target = self._target, None
        planned = self._interface.step(target, measured)
        stamp_ns = self._grid.substep_ns(self.next_due)
        self._cycles += 1
        self._schedule()
        if isinstance(planned, FreeTorque):
            rest = np.zeros_like(measured[0])
            planned = planned.torque_nm + self._torques_along(measured[0], rest, rest)
        if not isinstance(planned, Motion):
            return DriveCommand(planned, None, stamp_ns)
        wanted = np.stack(planned[:2])
        torque_nm = self._torques_along(*planned) if self._knows_arm else 0.0 * wanted[0]
        return DriveCommand(torque_nm, wanted, stamp_ns)

    def _schedule(self) -> None:
        begins_s = self._phase_s + self._cycles * self._period_s
        self.next_due = math.ceil(begins_s / self._grid.substep_s - 1e-6)
