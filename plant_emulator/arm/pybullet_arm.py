"""The arm by pybullet's own Python functions: pictures, and what a run's physics is held against.

In a run the arm is a `BulletArm`, which gives the same bits at less cost.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from bus_schema.arrays import Matrix, Vector
from bus_schema.errors import RobotDescriptionError
from bus_schema.robot_description import RobotDescription
from plant_emulator.arm.bullet_server import GRAVITY_M_S2, loadable_file
from plant_emulator.arm.quiet import quiet

with quiet():
    import pybullet
    from pybullet_utils.bullet_client import BulletClient

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
        self._server = server = BulletClient(pybullet.DIRECT)
        # Looked up once: that costs what a benchmark of pybullet's own calls must not measure.
        self._set_motors, self._get_states = server.setJointMotorControlArray, server.getJointStates
        self._step = server.stepSimulation
        # One body that never touches anything: looking for contacts would be a tenth of a step.
        server.resetSimulation(pybullet.RESET_USE_SIMPLE_BROADPHASE)
        self._body = self._load(robot, payload_kg)
        self._joints = self._find_joints(robot.joint_names)
        server.setGravity(0, 0, -GRAVITY_M_S2)
        server.setTimeStep(substep_s)
        for link in range(-1, server.getNumJoints(self._body)):
            server.changeDynamics(
                self._body, link, linearDamping=0, angularDamping=0, jointDamping=0
            )
        # Which every joint has at first.
        self._set_motors(
            self._body, self._joints, pybullet.VELOCITY_CONTROL, forces=[0.0] * robot.joints
        )
        self.position: Vector = np.zeros(robot.joints)
        self.velocity: Vector = np.zeros(robot.joints)

    def place(self, position: Vector) -> None:
        """Put the joints at `position` (rad, shape (joints,)), at rest."""
        for joint, angle in zip(self._joints, position, strict=True):
            self._server.resetJointState(self._body, joint, float(angle), 0.0)
        self._read()

    def step(self, torque_nm: Vector) -> None:
        """Apply joint torques (shape (joints,)) for one substep and read the joints."""
        self._take(self.step_bare(torque_nm.tolist()))

    def step_bare(self, torque_nm: list[float]) -> Sequence[Sequence[float]]:
        """The calls to pybullet that a substep cannot do without, and nothing else.

        Returns:
            pybullet's joint states, one for each joint: position (rad), velocity (rad/s), …
        """
        body, joints = self._body, self._joints
        self._set_motors(body, joints, pybullet.TORQUE_CONTROL, forces=torque_nm)
        self._step()
        states: Sequence[Sequence[float]] = self._get_states(body, joints)
        return states

    def advance(self) -> None:
        """One substep under the forces in force, and nothing else: the joints are not read."""
        self._step()

    def mass_matrix(self, position: Vector) -> Matrix:
        """Joint-space inertia at `position`, shape (joints, joints), kg m²."""
        order = np.argsort(self._joints)  # pybullet's own, which may differ from the URDF file's
        full = np.array(self._server.calculateMassMatrix(self._body, position[order].tolist()))
        inverse = np.argsort(order)
        return np.ascontiguousarray(full[np.ix_(inverse, inverse)])

    def extent(self, positions: Matrix) -> tuple[Vector, Vector]:
        """Corners of the box around all joints and links at all `positions`, m, shape (3,) each.

        Moves the arm: not for one that is running.

        Args:
            positions: joint positions, rad, shape (poses, joints).
        """
        points = [np.zeros(3)]
        links = range(self._server.getNumJoints(self._body))
        for position in positions:
            self.place(position)
            for link in links:
                state = self._server.getLinkState(self._body, link, computeForwardKinematics=True)
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
        _, _, colours, _, bodies = self._server.getCameraImage(
            width_px, height_px, view, projection, renderer=pybullet.ER_TINY_RENDERER,
            lightDirection=[1, -2, 3], shadow=0,
        )  # fmt: skip
        picture = np.array(colours, dtype=np.uint8).reshape(height_px, width_px, 4)[..., :3]
        picture[np.reshape(bodies, (height_px, width_px)) < 0] = 255
        return picture

    def close(self) -> None:
        """Free the physics server."""
        self._server.disconnect()

    def _read(self) -> None:
        self._take(self._get_states(self._body, self._joints))

    def _take(self, states: Sequence[Sequence[float]]) -> None:
        self.position[:], self.velocity[:] = ([state[row] for state in states] for row in range(2))

    def _load(self, robot: RobotDescription, payload_kg: float) -> int:
        try:
            with loadable_file(robot.path, robot.resolved_urdf(payload_kg)) as file:
                body: int = self._server.loadURDF(
                    str(file), useFixedBase=True, flags=pybullet.URDF_USE_INERTIA_FROM_FILE
                )
        except pybullet.error as error:
            raise RobotDescriptionError(f"{robot.path}: pybullet: {error}") from error
        return body

    def _find_joints(self, names: tuple[str, ...]) -> list[int]:
        index_by_name = {
            self._server.getJointInfo(self._body, link)[1].decode(): link
            for link in range(self._server.getNumJoints(self._body))
        }
        return [index_by_name[name] for name in names]
