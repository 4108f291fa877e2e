"""Interface of physics engines: the rigid bodies of an arm for the plant."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from bus_schema.arrays import Matrix, Vector
from bus_schema.robot_description import RobotDescription
from bus_schema.runtime.clock import TickGrid
from plant_emulator.arm.joint_torques import JointTorques
from plant_emulator.configuration import Integrator

ANY_PAYLOAD_KG = 1.0
"""Stands for any payload."""


@dataclass(frozen=True)
class ArmSpecification:
    """The arm that an engine has to build.

    Attributes:
        robot: description of the arm.
        grid: ticks and physics steps of the run.
        torques: everything that acts on the joints.
        integrator: the rule that integrates motion over a substep.
        payload_kg: point mass at the tip.
        rotor_inertia_kg_m2: inertia of rotors behind rigid gears, shape (joints,); None for none.
        payload_changes: whether the payload will change, see `ArmPhysics.carry`.
        gui: open the engine's window.
    """

    robot: RobotDescription
    grid: TickGrid
    torques: JointTorques
    integrator: Integrator = "semi_implicit_euler"
    payload_kg: float = 0.0
    rotor_inertia_kg_m2: Vector | None = None
    payload_changes: bool = False
    gui: bool = False

    @property
    def loaded_kg(self) -> float:
        """Payload to load the arm with: a later payload needs a body from the start."""
        return self.payload_kg or (ANY_PAYLOAD_KG if self.payload_changes else 0.0)


class ArmPhysics(ABC):
    """An arm on a fixed base, moved by the torques at its joints.

    Attributes:
        payload_kg: current point mass at the tip.
        motion: joint positions, rad, and velocities, rad/s, as rows, shape (2, joints).
        position: the first row.
        velocity: the second row.
    """

    def __init__(self, specification: ArmSpecification) -> None:
        self._torques = specification.torques
        self.payload_kg = specification.payload_kg
        self.motion: Matrix = np.zeros((2, specification.robot.joints))
        self.position: Vector = self.motion[0]
        self.velocity: Vector = self.motion[1]

    @staticmethod
    @abstractmethod
    def check(robot: RobotDescription, payload_kg: float, *, gui: bool) -> None:
        """Check that the engine can load an arm.

        Raises:
            RobotDescriptionError: it cannot.
        """

    @abstractmethod
    def place(self, position: Vector) -> None:
        """Put the joints at `position` (rad, shape (joints,)), at rest."""

    def set_brakes(self, *, engaged: bool) -> None:
        """Engage or release the brakes of all joints."""
        self.hold([engaged] * self.position.size)

    @abstractmethod
    def hold(self, joints: Sequence[bool]) -> None:
        """Engage the brakes of some joints, shape (joints,), and release those of the others."""

    def carry(self, payload_kg: float) -> None:
        """Carry this point mass at the tip from now on; joint velocities stay as they are."""
        self.payload_kg = payload_kg

    @abstractmethod
    def advance(self, first: int, end: int) -> None:
        """Compute substeps under the requested torque, and read the joints after each.

        Args:
            first: number of the first substep in the run.
            end: number of the first substep to leave out.

        Raises:
            ConnectionError: the engine is gone, for instance because its window was closed.
        """

    @abstractmethod
    def advance_braked(self, substeps: int) -> None:
        """Compute substeps with all brakes engaged and no other torque.

        Raises:
            ConnectionError: as for `advance`.
        """

    @abstractmethod
    def close(self) -> None:
        """Free the engine's resources."""
