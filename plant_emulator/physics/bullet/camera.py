"""Pictures of an arm by Bullet's software renderer.

By its C functions, as physics is: while it renders, other threads of Python go on.
"""

from __future__ import annotations

import ctypes

import numpy as np
from numpy.typing import NDArray

from bus_schema.arrays import Matrix, Vector
from bus_schema.errors import RobotDescriptionError
from bus_schema.robot_description import RobotDescription
from plant_emulator.physics.bullet.library import INT, POINTER, function, setter
from plant_emulator.physics.bullet.server import BulletServer

_CAMERA_FROM = np.array([0.55, -0.75, 0.36])
_FIELD_OF_VIEW_DEG = 35.0
_FRAME_MARGIN = 1.05
_LIGHT_FROM = (1.0, -2.0, 3.0)
_SOFTWARE_RENDERER = 1 << 16
_ANY_STEP_S = 1e-3
_FLOAT = ctypes.c_float
_Triple = _FLOAT * 3
_View = _FLOAT * 16


class _LinkState(ctypes.Structure):
    """``b3LinkState``."""

    _fields_ = (
        ("centre_of_mass", ctypes.c_double * 3),
        ("orientations_and_inertial_frame", ctypes.c_double * 11),
        ("position", ctypes.c_double * 3),
        ("rest", ctypes.c_double * 16),
    )


class _Image(ctypes.Structure):
    """``b3CameraImageData``: of each pixel its colour (RGBA), depth, and what is seen there."""

    _fields_ = (
        ("width", INT),
        ("height", INT),
        ("colours", ctypes.POINTER(ctypes.c_uint32)),
        ("depths", POINTER),
        ("bodies", ctypes.POINTER(ctypes.c_int32)),
    )


_request_state = function("RequestActualStateCommandInit", POINTER, POINTER, INT)
_with_kinematics = setter("RequestActualStateCommandComputeForwardKinematics", INT)
_number_of_joints = function("GetNumJoints", INT, POINTER, INT)
_link_state = function("GetLinkState", INT, POINTER, POINTER, INT, POINTER)
_view = function("ComputeViewMatrixFromPositions", None, _Triple, _Triple, _Triple, _View)
_projection = function("ComputeProjectionMatrixFOV", None, *[_FLOAT] * 4, _View)
_request_image = function("InitRequestCameraImage", POINTER, POINTER)
_set_matrices = function("RequestCameraImageSetCameraMatrices", None, POINTER, _View, _View)
_set_size = function("RequestCameraImageSetPixelResolution", None, POINTER, INT, INT)
_set_light = function("RequestCameraImageSetLightDirection", None, POINTER, _Triple)
_set_shadow = function("RequestCameraImageSetShadow", None, POINTER, INT)
_set_renderer = function("RequestCameraImageSelectRenderer", None, POINTER, INT)
_image = function("GetCameraImageData", None, POINTER, POINTER)


class ArmCamera:
    """An arm that is placed and looked at.

    Args:
        robot: description of the arm.

    Raises:
        RobotDescriptionError: Bullet cannot load the arm, not even without its meshes.
    """

    def __init__(self, robot: RobotDescription) -> None:
        try:
            self._server = BulletServer(robot, _ANY_STEP_S, shapes="drawable")
        except RobotDescriptionError:  # a mesh that cannot be read is no reason to do without
            self._server = BulletServer(robot, _ANY_STEP_S)

    def extent(self, positions: Matrix) -> tuple[Vector, Vector]:
        """Corners of the box around all joints and links at all `positions`, m, shape (3,) each.

        Args:
            positions: joint positions, rad, shape (poses, joints).
        """
        points = [np.zeros(3)]
        server, state = self._server, _LinkState()
        for position in positions:
            server.place(position)
            request = _request_state(server.handle, server.body)
            _with_kinematics(request, 1)
            answer = server.submit(request)
            for link in range(_number_of_joints(server.handle, server.body)):
                _link_state(server.handle, answer, link, ctypes.addressof(state))
                points += [np.array(state.centre_of_mass), np.array(state.position)]
        return np.min(points, axis=0), np.max(points, axis=0)

    def render(
        self,
        position: Vector,
        width_px: int,
        height_px: int,
        extent: tuple[Vector, Vector] | None = None,
    ) -> NDArray[np.uint8]:
        """Picture of the arm on white, shape (height, width, 3), RGB.

        Args:
            position: joint positions, rad, shape (joints,).
            width_px: width of the picture.
            height_px: height of the picture.
            extent: box that fills the picture, m; by default the arm's own at `position`.
        """
        box = extent or self.extent(position[None, :])
        server, image = self._server, _Image()
        server.place(position)
        request = _request_image(server.handle)
        _set_matrices(request, *look_at(box, width_px, height_px))
        _set_size(request, width_px, height_px)
        _set_light(request, _Triple(*_LIGHT_FROM))
        _set_shadow(request, 0)
        _set_renderer(request, _SOFTWARE_RENDERER)
        server.submit(request)
        _image(server.handle, ctypes.addressof(image))
        shape = (image.height, image.width)
        pixels = np.ctypeslib.as_array(image.colours, shape).copy()  # Bullet's memory is its own
        pixels[np.ctypeslib.as_array(image.bodies, shape) < 0] = 0xFFFFFFFF
        return pixels.view(np.uint8).reshape(*shape, 4)[..., :3]

    def close(self) -> None:
        """Free the physics server."""
        self._server.close()


def look_at(
    box: tuple[Vector, Vector], width_px: int, height_px: int
) -> tuple[ctypes.Array[ctypes.c_float], ctypes.Array[ctypes.c_float]]:
    """View and projection that have a box fill the picture."""
    lower, upper = box
    centre = (lower + upper) / 2
    radius = _FRAME_MARGIN * float(np.linalg.norm(upper - lower)) / 2
    half_angle = np.radians(_FIELD_OF_VIEW_DEG / 2)
    distance = float(radius / np.sin(half_angle) * max(1.0, height_px / width_px))
    eye = centre + distance * _CAMERA_FROM / np.linalg.norm(_CAMERA_FROM)
    view, projection = _View(), _View()
    _view(_Triple(*eye), _Triple(*centre), _Triple(0.0, 0.0, 1.0), view)
    near, far = distance / 10, distance * 10
    _projection(_FIELD_OF_VIEW_DEG, width_px / height_px, near, far, projection)
    return view, projection
