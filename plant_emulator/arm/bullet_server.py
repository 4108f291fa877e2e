"""Bullet's C interface, as pybullet's library carries it: a physics server with one arm.

pybullet's Python functions build lists, tuples and dictionaries around each of these calls, and
Python has to call them in every substep; these can be called from compiled code, as `bullet_arm.py`
does. Both end in the same functions, so they give the same bits. Names and arguments are those of
``examples/SharedMemory/PhysicsClientC_API.h`` and ``SharedMemoryPublic.h`` in Bullet's sources.
"""

from __future__ import annotations

import ctypes
import importlib.util
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from functools import lru_cache
from pathlib import Path
from typing import Any, NamedTuple

from bus_schema.arrays import Vector
from bus_schema.errors import RobotDescriptionError
from bus_schema.robot_description import PAYLOAD_LINK, RobotDescription
from bus_schema.runtime.compiled import c_function, compiled
from plant_emulator.arm.quiet import quiet

GRAVITY_M_S2 = 9.81
CONTROL_VELOCITY, CONTROL_TORQUE = 0, 1
_USE_SIMPLE_BROADPHASE = 4
_USE_INERTIA_FROM_FILE = 2
_BASE_LINK = -1
_NAME_BYTES = 1024
_ANY_PAYLOAD_KG = 1.0


class _JointInfo(ctypes.Structure):
    """The beginning of ``b3JointInfo``, and room for all the rest of it."""

    _fields_ = (
        ("link_name", ctypes.c_char * _NAME_BYTES),
        ("joint_name", ctypes.c_char * _NAME_BYTES),
        ("joint_type", ctypes.c_int),
        ("position_index", ctypes.c_int),
        ("velocity_index", ctypes.c_int),
        ("rest", ctypes.c_char * 2048),
    )


class Joint(NamedTuple):
    """Where to find a joint: among the links, and in lists of positions and of velocities."""

    link: int
    position_index: int
    velocity_index: int


def _load_library() -> ctypes.CDLL:
    found = importlib.util.find_spec("pybullet")
    if found is None or found.origin is None:
        raise ImportError("pybullet is not installed")
    return ctypes.CDLL(found.origin)


_LIBRARY = _load_library()
_POINTER, _INT, _DOUBLE = ctypes.c_void_p, ctypes.c_int, ctypes.c_double


def _function(name: str, result: Any, *arguments: Any) -> Any:
    function = getattr(_LIBRARY, "b3" + name)
    function.restype, function.argtypes = result, arguments
    return function


def _setter(name: str, *arguments: Any) -> Any:
    """A function that completes a command."""
    return _function(name, _INT, _POINTER, *arguments)


_connect = _function("ConnectPhysicsDirect", _POINTER)
_connect_window = _function("CreateInProcessPhysicsServerAndConnect", _POINTER, _INT, _POINTER)
_disconnect = _function("DisconnectSharedMemory", None, _POINTER)
_can_submit = _function("CanSubmitCommand", _INT, _POINTER)
_submit = _function("SubmitClientCommandAndWaitStatus", _POINTER, _POINTER, _POINTER)
_reset = _function("InitResetSimulationCommand", _POINTER, _POINTER)
_set_reset_flags = _setter("InitResetSimulationSetFlags", _INT)
_world = _function("InitPhysicsParamCommand", _POINTER, _POINTER)
_set_gravity = _setter("PhysicsParamSetGravity", _DOUBLE, _DOUBLE, _DOUBLE)
_set_time_step = _setter("PhysicsParamSetTimeStep", _DOUBLE)
_load_urdf = _function("LoadUrdfCommandInit", _POINTER, _POINTER, ctypes.c_char_p)
_set_fixed_base = _setter("LoadUrdfCommandSetUseFixedBase", _INT)
_set_load_flags = _setter("LoadUrdfCommandSetFlags", _INT)
_loaded_body = _function("GetStatusBodyIndex", _INT, _POINTER)
_number_of_joints = _function("GetNumJoints", _INT, _POINTER, _INT)
_joint_info = _function("GetJointInfo", _INT, _POINTER, _INT, _INT, _POINTER)
_dynamics = _function("InitChangeDynamicsInfo", _POINTER, _POINTER)
_set_linear_damping = _setter("ChangeDynamicsInfoSetLinearDamping", _INT, _DOUBLE)
_set_angular_damping = _setter("ChangeDynamicsInfoSetAngularDamping", _INT, _DOUBLE)
_set_joint_damping = _setter("ChangeDynamicsInfoSetJointDamping", _INT, _INT, _DOUBLE)
_set_mass = _setter("ChangeDynamicsInfoSetMass", _INT, _INT, _DOUBLE)
_set_inertia = _setter("ChangeDynamicsInfoSetLocalInertiaDiagonal", _INT, _INT, _POINTER)
_pose = _function("CreatePoseCommandInit", _POINTER, _POINTER, _INT)
_set_position = _setter("CreatePoseCommandSetJointPosition", _POINTER, _INT, _DOUBLE)
_set_velocity = _setter("CreatePoseCommandSetJointVelocity", _POINTER, _INT, _DOUBLE)
_control = _function("JointControlCommandInit2", _POINTER, _POINTER, _INT, _INT)
_set_desired_velocity = _setter("JointControlSetDesiredVelocity", _INT, _DOUBLE)
_set_velocity_gain = _setter("JointControlSetKd", _INT, _DOUBLE)
_set_largest_force = _setter("JointControlSetMaximumForce", _INT, _DOUBLE)

# The same interface as compiled code calls it; a handle is an unsigned integer there.
can_submit = c_function(_LIBRARY, "b3CanSubmitCommand", "intc", "uintp")
_submit_and_wait = c_function(
    _LIBRARY, "b3SubmitClientCommandAndWaitStatus", "uintp", "uintp", "uintp"
)
_send = c_function(_LIBRARY, "b3SubmitClientCommand", "intc", "uintp", "uintp")
_answer = c_function(_LIBRARY, "b3ProcessServerStatus", "uintp", "uintp")
control = c_function(_LIBRARY, "b3JointControlCommandInit2", "uintp", "uintp", "intc", "intc")
set_torque = c_function(
    _LIBRARY, "b3JointControlSetDesiredForceTorque", "intc", "uintp", "intc", "float64"
)
step_simulation = c_function(_LIBRARY, "b3InitStepSimulationCommand", "uintp", "uintp")
request_state = c_function(_LIBRARY, "b3RequestActualStateCommandInit", "uintp", "uintp", "intc")
get_state = c_function(_LIBRARY, "b3GetStatusActualState", "intc", *["uintp"] * 8)
copy_memory = c_function(ctypes.CDLL(None), "memcpy", "uintp", "uintp", "uintp", "uintp")


@compiled
def submit(server: int, command: int, has_window: bool) -> int:
    """Have a command carried out; its status, 0 if the server is gone.

    A server without a window has done so when the command is sent. Bullet's own function would
    look at the clock three times all the same, which makes a substep cost a fifteenth more.
    """
    status: int
    if has_window:
        status = _submit_and_wait(server, command)
    else:
        _send(server, command)
        status = _answer(server)
    return status


def no_answer() -> ConnectionError:
    """What is raised where the server is gone, as when its window was closed."""
    return ConnectionError("Bullet's physics server does not answer")


class BulletServer:
    """A physics server with one arm on a fixed base, without damping of Bullet's own.

    Args:
        robot: description of the arm.
        substep_s: length of one physics step.
        payload_kg: point mass at the tip.
        payload_changes: whether there will be another one, see `carry`.
        gui: open Bullet's window (needs a display).

    Attributes:
        payload_kg: point mass at the tip, as of now.
        handle: the server, as Bullet's functions take it.
        body: the arm, as Bullet's functions take it.
        joints: the arm's joints, in the order of `RobotDescription.joint_names`.

    Raises:
        RobotDescriptionError: Bullet cannot load the arm.
    """

    def __init__(
        self, robot: RobotDescription, substep_s: float, *,
        payload_kg: float, payload_changes: bool, gui: bool,
    ) -> None:  # fmt: skip
        with quiet():
            self.handle: int = _connect_window(0, None) if gui else _connect()
        reset = _reset(self.handle)
        # One body that never touches anything: looking for contacts would be a tenth of a step.
        _set_reset_flags(reset, _USE_SIMPLE_BROADPHASE)
        self._submit(reset)
        try:
            # Bullet cannot add a link later: one without mass is there for what is picked up.
            at_first_kg = payload_kg or (_ANY_PAYLOAD_KG if payload_changes else 0.0)
            self.body = _load(self.handle, robot.path, robot.resolved_urdf(at_first_kg))
        except RobotDescriptionError:
            self.close()
            raise
        names = self._link_names()
        self.joints = [names[name][0] for name in robot.joint_names]
        self._payload_links = [
            joint.link for joint, link_name in names.values() if link_name == PAYLOAD_LINK
        ]
        self.payload_kg = payload_kg
        if at_first_kg != payload_kg:
            self.carry(payload_kg)
        self._set_up_world(substep_s, len(names))

    def place(self, position: Vector) -> None:
        """Put the joints at `position` (rad, shape (joints,)), at rest."""
        for joint, angle in zip(self.joints, position.tolist(), strict=True):
            pose = _pose(self.handle, self.body)
            _set_position(self.handle, pose, joint.link, angle)
            _set_velocity(self.handle, pose, joint.link, 0.0)
            self._submit(pose)

    def hold_with(self, torques_nm: Sequence[float]) -> None:
        """Hold each joint at rest with so much torque at most; 0 lets it go."""
        motors = _control(self.handle, self.body, CONTROL_VELOCITY)
        for joint, torque_nm in zip(self.joints, torques_nm, strict=True):
            _set_desired_velocity(motors, joint.velocity_index, 0.0)
            _set_velocity_gain(motors, joint.velocity_index, 1.0)
            _set_largest_force(motors, joint.velocity_index, torque_nm)
        self._submit(motors)

    def carry(self, payload_kg: float) -> None:
        """Carry this point mass at the tip from now on; one that was announced (see the class).

        It comes with the velocity of the tip: those of the joints stay as they are.
        """
        self.payload_kg = payload_kg
        for link in self._payload_links:
            change = _dynamics(self.handle)
            _set_mass(change, self.body, link, payload_kg)
            # left to itself, Bullet makes up an inertia of what it takes for the link's extent
            _set_inertia(change, self.body, link, (_DOUBLE * 3)())
            self._submit(change)

    def close(self) -> None:
        """Free the server."""
        _disconnect(self.handle)

    def _submit(self, command: int) -> int:
        if not _can_submit(self.handle):
            raise no_answer()
        status: int = _submit(self.handle, command)
        return status

    def _link_names(self) -> dict[str, tuple[Joint, str]]:
        """Joint and link by name of the joint."""
        by_name = {}
        info = _JointInfo()
        for link in range(_number_of_joints(self.handle, self.body)):
            _joint_info(self.handle, self.body, link, ctypes.addressof(info))
            joint = Joint(link, info.position_index, info.velocity_index)
            by_name[info.joint_name.decode()] = (joint, info.link_name.decode())
        return by_name

    def _set_up_world(self, substep_s: float, links: int) -> None:
        world = _world(self.handle)
        _set_gravity(world, 0.0, 0.0, -GRAVITY_M_S2)
        _set_time_step(world, substep_s)
        self._submit(world)
        for link in range(_BASE_LINK, links):
            change = _dynamics(self.handle)
            _set_linear_damping(change, self.body, 0.0)
            _set_angular_damping(change, self.body, 0.0)
            _set_joint_damping(change, self.body, link, 0.0)
            self._submit(change)


@lru_cache(maxsize=16)
def require_loadable(path: Path, urdf: str) -> None:
    """Check that Bullet can load an arm; what it could load before, it need not load again.

    Args:
        path: the arm's file.
        urdf: `RobotDescription.resolved_urdf`.

    Raises:
        RobotDescriptionError: it cannot.
    """
    server = _connect()
    try:
        _load(server, path, urdf)
    finally:
        _disconnect(server)


@contextmanager
def loadable_file(path: Path, urdf: str) -> Iterator[Path]:
    """The URDF as a file for Bullet to load, without a word on the terminal.

    Args:
        path: the arm's file, whose name it bears.
        urdf: `RobotDescription.resolved_urdf`.
    """
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / path.name
        file.write_text(urdf)
        with quiet():
            yield file


def _load(server: int, path: Path, urdf: str) -> int:
    with loadable_file(path, urdf) as file:
        load = _load_urdf(server, bytes(file))
        _set_fixed_base(load, 1)
        _set_load_flags(load, _USE_INERTIA_FROM_FILE)
        body: int = _loaded_body(_submit(server, load))
    if body < 0:
        raise RobotDescriptionError(f"{path}: pybullet cannot load it")
    return body
