"""The bodies of the engine ``flywheels``."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from bus_schema.arrays import Vector
from bus_schema.robot_description import RobotDescription
from plant_emulator.arm.joint_torques import TOTAL, joint_torques
from plant_emulator.physics.engine import ArmPhysics, ArmSpecification

INERTIA_KG_M2 = 1.0


class Flywheels(ArmPhysics):
    """Flywheels without gravity or coupling."""

    def __init__(self, specification: ArmSpecification) -> None:
        super().__init__(specification)
        self._grid = specification.grid
        self._is_held = np.zeros(self.position.size, np.bool_)

    @staticmethod
    def check(robot: RobotDescription, payload_kg: float, *, gui: bool) -> None:
        pass

    def place(self, position: Vector) -> None:
        self.position[:], self.velocity[:] = position, 0.0

    def hold(self, joints: Sequence[bool]) -> None:
        self._is_held[:] = joints
        self.velocity[self._is_held] = 0.0

    def advance(self, first: int, end: int) -> None:
        grid, tables = self._grid, self._torques.tables
        for number in range(first, end):
            time_s = (number * grid.period_ns // grid.substeps) * 1e-9
            saturated, hits = joint_torques(self.motion, time_s, tables)
            self._torques.note(saturated=saturated, hits=hits)
            acceleration = tables.torques_nm[TOTAL] / INERTIA_KG_M2
            self.velocity += np.where(self._is_held, 0.0, grid.substep_s * acceleration)
            self.position += grid.substep_s * self.velocity

    def advance_braked(self, substeps: int) -> None:
        self.velocity[:] = 0.0

    def close(self) -> None:
        pass
