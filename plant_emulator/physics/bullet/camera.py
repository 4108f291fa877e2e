"""Pictures of an arm by Bullet's software renderer."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from bus_schema.arrays import Matrix, Vector
from bus_schema.errors import RobotDescriptionError
from bus_schema.robot_description import RobotDescription, Shapes
from plant_emulator.physics.bullet.library import quiet
from plant_emulator.physics.bullet.server import loadable_file

with quiet():  # it prints at import and on connecting
    import pybullet
    from pybullet_utils.bullet_client import BulletClient

_CAMERA_FROM = np.array([0.55, -0.75, 0.36])
_FIELD_OF_VIEW_DEG = 35.0
_FRAME_MARGIN = 1.05
_LIGHT_FROM = (1.0, -2.0, 3.0)
_CENTRE_OF_MASS, _ORIGIN = 0, 4
"""Indices in the state of a link."""


class ArmCamera:
    """Camera for pictures of an arm in given postures.

    Args:
        robot: description of the arm.

    Raises:
        RobotDescriptionError: Bullet cannot load the arm, even without its meshes.
    """

    def __init__(self, robot: RobotDescription) -> None:
        self._robot = robot
        with quiet():
            self._client = BulletClient(pybullet.DIRECT)
        try:
            self._body = self._load("drawable")
        except pybullet.error:  # an unreadable mesh must not prevent a picture
            try:
                self._body = self._load("none")
            except pybullet.error as error:
                raise RobotDescriptionError(f"{robot.path}: pybullet cannot load it") from error
        links = range(self._client.getNumJoints(self._body))
        infos = [self._client.getJointInfo(self._body, link) for link in links]
        self._link = {info[1].decode(): info[0] for info in infos}

    def extent(self, positions: Matrix) -> tuple[Vector, Vector]:
        """Return the corners of the box around the arm at all `positions`, m, shape (3,) each.

        Args:
            positions: joint positions, rad, shape (poses, joints).
        """
        points = [np.zeros(3)]
        for position in positions:
            self._place(position)
            for link in self._link.values():
                state = self._client.getLinkState(self._body, link, computeForwardKinematics=True)
                points += [np.array(state[_CENTRE_OF_MASS]), np.array(state[_ORIGIN])]
        return np.min(points, axis=0), np.max(points, axis=0)

    def render(
        self,
        position: Vector,
        width_px: int,
        height_px: int,
        extent: tuple[Vector, Vector] | None = None,
    ) -> NDArray[np.uint8]:
        """Return a picture of the arm on white, shape (height, width, 3), RGB.

        Args:
            position: joint positions, rad, shape (joints,).
            width_px: width of the picture.
            height_px: height of the picture.
            extent: box that fills the picture, m; by default the arm's own at `position`.
        """
        lower, upper = extent or self.extent(position[None, :])
        self._place(position)
        centre = (lower + upper) / 2
        radius = _FRAME_MARGIN * float(np.linalg.norm(upper - lower)) / 2
        half_angle = np.radians(_FIELD_OF_VIEW_DEG / 2)
        distance = float(radius / np.sin(half_angle) * max(1.0, height_px / width_px))
        eye = centre + distance * _CAMERA_FROM / np.linalg.norm(_CAMERA_FROM)
        _, _, colours, _, bodies = self._client.getCameraImage(
            width_px,
            height_px,
            pybullet.computeViewMatrix(eye.tolist(), centre.tolist(), (0.0, 0.0, 1.0)),
            pybullet.computeProjectionMatrixFOV(
                _FIELD_OF_VIEW_DEG, width_px / height_px, distance / 10, distance * 10
            ),
            lightDirection=_LIGHT_FROM,
            shadow=0,
            renderer=pybullet.ER_TINY_RENDERER,
        )
        pixels = np.array(colours, np.uint8).reshape(height_px, width_px, 4)
        pixels[np.reshape(bodies, (height_px, width_px)) < 0] = 255
        return pixels[..., :3]

    def close(self) -> None:
        """Free the physics server."""
        self._client.disconnect()

    def _load(self, shapes: Shapes) -> int:
        with loadable_file(self._robot.path, self._robot.resolved_urdf(0.0, shapes)) as file:
            body: int = self._client.loadURDF(str(file), useFixedBase=True)
        return body

    def _place(self, position: Vector) -> None:
        for name, angle in self._robot.joint_positions(position).items():
            self._client.resetJointState(self._body, self._link[name], angle)
