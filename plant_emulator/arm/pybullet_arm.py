"""The arm by pybullet's own Python functions: pictures, and what a run's physics is held against.

In a run the arm is a `BulletArm`, which gives the same bits at less cost.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from bus_schema.arrays import Matrix, Vector
from bus_schema.errors import RobotDescriptionError
from bus_schema.robot_description import RobotDescription, Shapes
from plant_emulator.arm.bullet_server import GRAVITY_M_S2, loadable_file
from plant_emulator.arm.quiet import quiet

with quiet():
    import pybullet

_CAMERA_FROM = np.array([0.55, -0.75, 0.36])
_FIELD_OF_VIEW_DEG = 35.0
_FRAME_MARGIN = 1.05


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

    def extent(self, positions: Matrix) -> tuple[Vector, Vector]:
        """Corners of the box around all joints and links at all `positions`, m, shape (3,) each.

        Moves the arm: not for one that is running.

        Args:
            positions: joint positions, rad, shape (poses, joints).
        """
        points = [np.zeros(3)]
        links = range(pybullet.getNumJoints(self._body, physicsClientId=self._client))
        for position in positions:
            self.place(position)
            for link in links:
                state = pybullet.getLinkState(
                    self._body, link, computeForwardKinematics=True, physicsClientId=self._client
                )
                points += [np.array(state[0]), np.array(state[4])]
        return np.min(points, axis=0), np.max(points, axis=0)

    def render(
        self,
        position: Vector,
        width_px: int,
        height_px: int,
        extent: tuple[Vector, Vector] | None = None,
    ) -> NDArray[np.uint8]:
        """Picture of the arm on white by the software renderer, shape (height, width, 3), RGB.

        Moves the arm: not for one that is running.

        Args:
            position: joint positions, rad, shape (joints,).
            width_px: width of the picture.
            height_px: height of the picture.
            extent: box that fills the picture, m; by default the arm's own at `position`.
        """
        lower, upper = extent or self.extent(position[None, :])
        self.place(position)
        centre = (lower + upper) / 2
        radius = _FRAME_MARGIN * float(np.linalg.norm(upper - lower)) / 2
        half_angle = np.radians(_FIELD_OF_VIEW_DEG / 2)
        distance = radius / np.sin(half_angle) * max(1.0, height_px / width_px)
        eye = centre + distance * _CAMERA_FROM / np.linalg.norm(_CAMERA_FROM)
        view = pybullet.computeViewMatrix(eye.tolist(), centre.tolist(), [0, 0, 1])
        projection = pybullet.computeProjectionMatrixFOV(
            _FIELD_OF_VIEW_DEG, width_px / height_px, distance / 10, distance * 10
        )
        _, _, colours, _, bodies = pybullet.getCameraImage(
            width_px, height_px, view, projection, renderer=pybullet.ER_TINY_RENDERER,
            lightDirection=[1, -2, 3], shadow=0, physicsClientId=self._client,
        )  # fmt: skip
        picture = np.array(colours, dtype=np.uint8).reshape(height_px, width_px, 4)
        pixels = picture.view(np.uint32)[..., 0]  # whole ones take a quarter of the time
        pixels[np.reshape(bodies, (height_px, width_px)) < 0] = 0xFFFFFFFF
        return picture[..., :3]

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
