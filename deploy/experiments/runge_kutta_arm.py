"""An arm whose rigid bodies are pinocchio's, integrated by Runge and Kutta: nothing of Bullet."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from bus_schema.arrays import Matrix, Vector
from bus_schema.robot_description import RobotDescription
from bus_schema.runtime.clock import TickGrid
from controller.manipulator_model import ManipulatorModel
from plant_emulator.arm.joint_torques import TOTAL, JointTorques, joint_torques


class RungeKuttaArm:
    """What `ArmPlant` asks of its physics, by the classical fourth-order rule.

    Torques are those of `joint_torques` and constant over a substep, as in Bullet: actuators,
    friction and disturbance are evaluated once, at its start. So what differs is the dynamics
    (articulated bodies in pinocchio) and the integration (in Bullet semi-implicit Euler).

    Args:
        robot: description of the arm.
        grid: ticks and physics steps of the run.
        torques: all that acts on the joints.
        payload_kg: point mass at the tip.
        payload_changes: here it always may.
        gui: there is no window; what it says is passed over.

    Attributes:
        motion: positions, rad, and velocities, rad/s, as rows, shape (2, joints).
        position: the first row.
        velocity: the second row.
        payload_kg: point mass at the tip, as of now.
    """

    def __init__(
        self,
        robot: RobotDescription,
        grid: TickGrid,
        torques: JointTorques,
        *,
        payload_kg: float = 0.0,
        payload_changes: bool = False,  # noqa: ARG002 (Bullet's)
        gui: bool = False,  # noqa: ARG002 (Bullet's)
    ) -> None:
        self._robot, self._grid, self._torques = robot, grid, torques
        self.carry(payload_kg)
        self.motion: Matrix = np.zeros((2, robot.joints))
        self.position: Vector = self.motion[0]
        self.velocity: Vector = self.motion[1]

    def place(self, position: Vector) -> None:
        """Put the arm somewhere, at rest."""
        self.position[:], self.velocity[:] = position, 0.0

    def set_brakes(self, *, engaged: bool) -> None:
        """The brakes are ideal: see `advance_braked`."""

    def hold(self, joints: Sequence[bool]) -> None:
        """Brakes of single joints are the drives' on a CAN bus.

        Raises:
            NotImplementedError: one is to hold.
        """
        if any(joints):
            raise NotImplementedError("brakes of single joints")

    def carry(self, payload_kg: float) -> None:
        """Have this point mass at the tip from now on."""
        self.payload_kg = payload_kg
        self._model = ManipulatorModel(self._robot, payload_kg=payload_kg)

    def advance(self, first: int, end: int) -> None:
        """Go through substeps under the torque that is asked for.

        Args:
            first: number of the first substep in the run.
            end: number of the first one not to go through.
        """
        torques = self._torques
        for number in range(first, end):
            time_s = self._grid.substep_ns(number) * 1e-9
            saturated, hits = joint_torques(self.motion, time_s, torques.tables)
            torques.note(saturated=saturated, hits=hits)
            self._step(torques.tables.torques_nm[TOTAL])

    def advance_braked(self, substeps: int) -> None:  # noqa: ARG002 (Bullet's)
        """The brakes hold."""
        self.velocity[:] = 0.0

    def close(self) -> None:
        """There is nothing to free."""

    def _step(self, torque_nm: Vector) -> None:
        acceleration, step_s = self._model.forward_dynamics, self._grid.substep_s
        half_s = 0.5 * step_s
        q, v_1 = self.position, self.velocity
        a_1 = acceleration(q, v_1, torque_nm)
        v_2 = v_1 + half_s * a_1
        a_2 = acceleration(q + half_s * v_1, v_2, torque_nm)
        v_3 = v_1 + half_s * a_2
        a_3 = acceleration(q + half_s * v_2, v_3, torque_nm)
        v_4 = v_1 + step_s * a_3
        a_4 = acceleration(q + step_s * v_3, v_4, torque_nm)
        q += step_s / 6.0 * (v_1 + 2.0 * (v_2 + v_3) + v_4)
        v_1 += step_s / 6.0 * (a_1 + 2.0 * (a_2 + a_3) + a_4)
