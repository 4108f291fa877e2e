"""The arm's rigid-body physics: pybullet, one physics server per arm."""

from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np
import pybullet

from bus_schema.arrays import Vector
from bus_schema.robot_description import RobotDescription

GRAVITY_M_S2 = 9.81
_BRAKE_TO_EFFORT = 10.0
_BRAKE_TORQUE_NM = 10_000.0


class PybulletArm:
    """An arm on a fixed base, without damping, motors or friction of pybullet's own.

    Args:
        robot: description of the arm.
        substep_s: length of one physics step.
        payload_kg: point mass at the tip.
        gui: open pybullet's window (needs a display).
    """

    def __init__(
        self,
        robot: RobotDescription,
        substep_s: float,
        *,
        payload_kg: float = 0.0,
        gui: bool = False,
    ) -> None:
        self._client = pybullet.connect(pybullet.GUI if gui else pybullet.DIRECT)
        self._body = self._load(robot, payload_kg)
        self._joints = self._find_joints(robot.joint_names)
        self._brake_torques = [
            _BRAKE_TO_EFFORT * limit if np.isfinite(limit) else _BRAKE_TORQUE_NM
            for limit in robot.effort_limits_nm
        ]
        pybullet.setGravity(0, 0, -GRAVITY_M_S2, physicsClientId=self._client)
        pybullet.setTimeStep(substep_s, physicsClientId=self._client)
        for link in range(-1, pybullet.getNumJoints(self._body, physicsClientId=self._client)):
            pybullet.changeDynamics(
                self._body, link, linearDamping=0, angularDamping=0, jointDamping=0,
                physicsClientId=self._client,
            )  # fmt: skip
        self.position: Vector = np.zeros(robot.joints)
        self.velocity: Vector = np.zeros(robot.joints)
        self.set_brakes(engaged=False)

    def place(self, position: Vector) -> None:
        """Put the joints at `position` (rad, shape (joints,)), at rest."""
        for joint, angle in zip(self._joints, position, strict=True):
            pybullet.resetJointState(
                self._body, joint, float(angle), 0.0, physicsClientId=self._client
            )
        self._read()

    def set_brakes(self, *, engaged: bool) -> None:
        """Engage or release brakes that hold every joint against ten times its largest torque."""
        forces = self._brake_torques if engaged else [0.0] * len(self._joints)
        pybullet.setJointMotorControlArray(
            self._body, self._joints, pybullet.VELOCITY_CONTROL, forces=forces,
            physicsClientId=self._client,
        )  # fmt: skip

    def step(self, torque_nm: Vector) -> None:
        """Apply joint torques (shape (joints,)) for one substep and read the joints."""
        pybullet.setJointMotorControlArray(
            self._body, self._joints, pybullet.TORQUE_CONTROL, forces=torque_nm.tolist(),
            physicsClientId=self._client,
        )  # fmt: skip
        pybullet.stepSimulation(physicsClientId=self._client)
        self._read()

    def step_braked(self) -> None:
        """One substep with the brakes engaged and no torque."""
        pybullet.stepSimulation(physicsClientId=self._client)
        self._read()

    def mass_matrix(self, position: Vector) -> Vector:
        """Joint-space inertia at `position`, shape (joints, joints), kg m²."""
        return np.array(
            pybullet.calculateMassMatrix(
                self._body, position.tolist(), physicsClientId=self._client
            )
        )

    def close(self) -> None:
        """Free the physics server."""
        pybullet.disconnect(physicsClientId=self._client)

    def _read(self) -> None:
        position, velocity = self.position, self.velocity
        states = pybullet.getJointStates(self._body, self._joints, physicsClientId=self._client)
        for index, state in enumerate(states):
            position[index] = state[0]
            velocity[index] = state[1]

    def _load(self, robot: RobotDescription, payload_kg: float) -> int:
        with tempfile.TemporaryDirectory() as folder:
            file = Path(folder) / robot.path.name
            file.write_text(robot.resolved_urdf(payload_kg))
            body: int = pybullet.loadURDF(
                str(file), useFixedBase=True, flags=pybullet.URDF_USE_INERTIA_FROM_FILE,
                physicsClientId=self._client,
            )  # fmt: skip
        return body

    def _find_joints(self, names: tuple[str, ...]) -> list[int]:
        count = pybullet.getNumJoints(self._body, physicsClientId=self._client)
        index_by_name = {
            pybullet.getJointInfo(self._body, i, physicsClientId=self._client)[1].decode(): i
            for i in range(count)
        }
        return [index_by_name[name] for name in names]
