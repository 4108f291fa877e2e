"""The arm by pybullet's own Python functions: what a run's physics is held against.

In a run the arm is a `BulletArm`, which gives the same bits at less cost.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from bus_schema.arrays import Matrix, Vector
from bus_schema.errors import RobotDescriptionError
from bus_schema.robot_description import RobotDescription, Shapes
from plant_emulator.arm.bullet_server import GRAVITY_M_S2, loadable_file
from plant_emulator.arm.quiet import quiet

with quiet():
    import pybullet


class PybulletArm:
    """An arm on a fixed base, without damping, motors or friction of pybullet's own.

    Args:
        robot: description of the arm.
        substep_s: length of one physics step.
        payload_kg: point mass at the tip.

    Attributes:
        position: joint positions, rad, shape (joints,).
        velocity: joint velocities, rad/s, shape (joints,).

    Raises:
        RobotDescriptionError: pybullet cannot load the arm.
    """

    def __init__(
        self, robot: RobotDescription, substep_s: float, *, payload_kg: float = 0.0
    ) -> None:
        self._client = pybullet.connect(pybullet.DIRECT)
        # One body that never touches anything: looking for contacts would be a tenth of a step.
        pybullet.resetSimulation(pybullet.RESET_USE_SIMPLE_BROADPHASE, physicsClientId=self._client)
        self._body = self._load(robot, payload_kg)
        self._joints = self._find_joints(robot.joint_names)
        self._followers = robot.followers
        self._leaders = [robot.joint_names.index(each.leader) for each in robot.followers]
        self._following = self._find_joints([each.name for each in robot.followers])
        pybullet.setGravity(0, 0, -GRAVITY_M_S2, physicsClientId=self._client)
        pybullet.setTimeStep(substep_s, physicsClientId=self._client)
        for link in range(-1, pybullet.getNumJoints(self._body, physicsClientId=self._client)):
            pybullet.changeDynamics(
                self._body, link, linearDamping=0, angularDamping=0, jointDamping=0,
                physicsClientId=self._client,
            )  # fmt: skip
        pybullet.setJointMotorControlArray(  # which every joint has at first
            self._body, self._joints, pybullet.VELOCITY_CONTROL, forces=[0.0] * robot.joints,
            physicsClientId=self._client,
        )  # fmt: skip
        self.position: Vector = np.zeros(robot.joints)
        self.velocity: Vector = np.zeros(robot.joints)

    def place(self, position: Vector) -> None:
        """Put the joints at `position` (rad, shape (joints,)), at rest."""
        led = zip(self._leaders, self._followers, strict=True)
        angles = [*position, *(each.multiplier * position[i] + each.offset for i, each in led)]
        for joint, angle in zip([*self._joints, *self._following], angles, strict=True):
            pybullet.resetJointState(
                self._body, joint, float(angle), 0.0, physicsClientId=self._client
            )
        self._read()

    def step(self, torque_nm: Vector) -> None:
        """Apply joint torques (shape (joints,)) for one substep and read the joints."""
        self._take(self.step_bare(torque_nm.tolist()))

    def step_bare(self, torque_nm: list[float]) -> Sequence[Sequence[float]]:
        """The calls to pybullet that a substep cannot do without, and nothing else.

        Returns:
            pybullet's joint states, one for each joint: position (rad), velocity (rad/s), …
        """
        client, body, joints = self._client, self._body, self._joints
        pybullet.setJointMotorControlArray(
            body, joints, pybullet.TORQUE_CONTROL, forces=torque_nm, physicsClientId=client
        )
        pybullet.stepSimulation(physicsClientId=client)
        states: Sequence[Sequence[float]] = pybullet.getJointStates(
            body, joints, physicsClientId=client
        )
        return states

    def advance(self) -> None:
        """One substep under the forces in force, and nothing else: the joints are not read."""
        pybullet.stepSimulation(physicsClientId=self._client)

    def mass_matrix(self, position: Vector) -> Matrix:
        """Joint-space inertia at `position`, shape (joints, joints), kg m²."""
        order = np.argsort(self._joints)  # pybullet's own, which may differ from the URDF file's
        full = np.array(
            pybullet.calculateMassMatrix(
                self._body, position[order].tolist(), physicsClientId=self._client
            )
        )
        inverse = np.argsort(order)
        return np.ascontiguousarray(full[np.ix_(inverse, inverse)])

    def close(self) -> None:
        """Free the physics server."""
        pybullet.disconnect(physicsClientId=self._client)

    def _read(self) -> None:
        self._take(pybullet.getJointStates(self._body, self._joints, physicsClientId=self._client))

    def _take(self, states: Sequence[Sequence[float]]) -> None:
        self.position[:], self.velocity[:] = ([state[row] for state in states] for row in range(2))

    def _load(self, robot: RobotDescription, payload_kg: float) -> int:
        try:
            return self._load_with(robot, payload_kg, "drawable")
        except pybullet.error:  # a mesh that cannot be read is no reason to do without the arm
            pass
        try:
            return self._load_with(robot, payload_kg, "none")
        except pybullet.error as error:
            raise RobotDescriptionError(f"{robot.path}: pybullet: {error}") from error

    def _load_with(self, robot: RobotDescription, payload_kg: float, shapes: Shapes) -> int:
        with loadable_file(robot.path, robot.resolved_urdf(payload_kg, shapes)) as file:
            body: int = pybullet.loadURDF(
                str(file), useFixedBase=True, flags=pybullet.URDF_USE_INERTIA_FROM_FILE,
                physicsClientId=self._client,
            )  # fmt: skip
        return body

    def _find_joints(self, names: Sequence[str]) -> list[int]:
        count = pybullet.getNumJoints(self._body, physicsClientId=self._client)
        index_by_name = {
            pybullet.getJointInfo(self._body, i, physicsClientId=self._client)[1].decode(): i
            for i in range(count)
        }
        return [index_by_name[name] for name in names]
