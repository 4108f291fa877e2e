"""An arm whose joints are moved, slowed down and held by their own motor drives."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from bus_schema.arrays import Vector
from bus_schema.limits import LimitsConfiguration
from bus_schema.robot_description import RobotDescription
from bus_schema.runtime.clock import TickGrid
from plant_emulator.arm.arm_plant import ArmPlant
from plant_emulator.configuration import PlantConfiguration
from plant_emulator.drives.bank import DriveBank
from plant_emulator.faults.fault import Fault


class DrivenArm(ArmPlant):
    """An arm with drives: what a command says is theirs to carry out, and so is every stop.

    Args:
        configuration: section ``plant`` of the scenario; of its safe stop nothing is needed.
        robot: description of the arm.
        start_position_rad: joint positions at the start, shape (joints,).
        grid: ticks and physics steps of the run.
        seed: seed of everything random in the arm.
        limits: section ``limits`` of the scenario.
        faults: what breaks, and when.
    """

    def __init__(
        self,
        configuration: PlantConfiguration,
        robot: RobotDescription,
        start_position_rad: Vector,
        grid: TickGrid,
        seed: int,
        limits: LimitsConfiguration,
        faults: Sequence[Fault] = (),
    ) -> None:
        left_alone = configuration.model_copy(update={"safe_stop": "zero_torque"})
        super().__init__(left_alone, robot, start_position_rad, grid, seed, limits, faults)
        self._bank: DriveBank | None = None

    def attach(self, bank: DriveBank) -> None:
        """Give the joints their drives."""
        self._bank = bank

    def advance(self, first: int, end: int) -> None:
        if self._bank is not None:
            self.hold(self._bank.braked)
            np.copyto(self._commanded, self._bank.torque_nm)
        super().advance(first, end)
