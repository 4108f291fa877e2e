"""Bullet's C interface in pybullet's library: a physics server with one arm.

pybullet's Python functions build lists, tuples and dictionaries around each of these calls, and
Python has to call them in every substep; compiled code can call the C functions directly
(`arm.py`). Both call the same functions, so they give the same bits.
"""

from __future__ import annotations

import ctypes
import tempfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import lru_cache
from pathlib import Path
from typing import NamedTuple

from bus_schema.arrays import Vector
from bus_schema.errors import RobotDescriptionError
from bus_schema.robot_description import Shapes
from bus_schema.runtime.compiled import c_function, compiled
from bus_schema.urdf.joints import Follower
from bus_schema.urdf.resolved import PAYLOAD_LINK
from plant_emulator.physics.bullet.library import (
    DOUBLE,
    INT,
    LIBRARY,
    POINTER,
    JointInfo,
    function,
    quiet,
    setter,
)
from plant_emulator.physics.engine import ArmSpecification

_GEAR = 6
_LARGEST_FORCE = 1e9

_couple = function("InitCreateUserConstraintCommand", POINTER, POINTER, INT, INT, INT, INT, POINTER)
_couple_id = function("GetStatusUserConstraintUniqueId", INT, POINTER)
_change_couple = function("InitChangeUserConstraintCommand", POINTER, POINTER, INT)
_set_gear_ratio = setter("InitChangeUserConstraintSetGearRatio", DOUBLE)
_set_gear_force = setter("InitChangeUserConstraintSetMaxForce", DOUBLE)
_set_gear_erp = setter("InitChangeUserConstraintSetERP", DOUBLE)
_set_gear_offset = setter("InitChangeUserConstraintSetRelativePositionTarget", DOUBLE)


def tie(
    server: int, body: int, links: tuple[int, int], follower: Follower, submit: Callable[[int], int]
) -> None:
    """Couple a joint to another one: q = multiplier × q of the leader + offset.

    The solver couples their speeds in every step; an error in position decays in a few steps.

    Args:
        server: the physics server.
        body: the arm there.
        links: numbers of the joint that follows and of its leader.
        follower: how it follows.
        submit: has a command carried out; gives its status.
    """
    link, leader = links
    info = JointInfo(joint_type=_GEAR)
    info.parent_frame[6] = info.child_frame[6] = 1.0  # no rotation
    create = _couple(server, body, link, body, leader, ctypes.addressof(info))
    change = _change_couple(server, _couple_id(submit(create)))
    _set_gear_ratio(change, -follower.multiplier)
    _set_gear_offset(change, follower.offset)
    _set_gear_force(change, _LARGEST_FORCE)
    _set_gear_erp(change, 1.0)
    submit(change)


GRAVITY_M_S2 = 9.81
CONTROL_VELOCITY, CONTROL_TORQUE = 0, 1
_USE_SIMPLE_BROADPHASE = 4
_USE_INERTIA_FROM_FILE = 2
_BASE_LINK = -1
_MOST_ITERATIONS = 500


class Joint(NamedTuple):
    """Indices of a joint: among the links, and in lists of positions and of velocities."""

    link: int
    position_index: int
    velocity_index: int


_connect = function("ConnectPhysicsDirect", POINTER)
_connect_window = function("CreateInProcessPhysicsServerAndConnect", POINTER, INT, POINTER)
_disconnect = function("DisconnectSharedMemory", None, POINTER)
_can_submit = function("CanSubmitCommand", INT, POINTER)
_submit = function("SubmitClientCommandAndWaitStatus", POINTER, POINTER, POINTER)
_reset = function("InitResetSimulationCommand", POINTER, POINTER)
_set_reset_flags = setter("InitResetSimulationSetFlags", INT)
_world = function("InitPhysicsParamCommand", POINTER, POINTER)
_set_gravity = setter("PhysicsParamSetGravity", DOUBLE, DOUBLE, DOUBLE)
_set_time_step = setter("PhysicsParamSetTimeStep", DOUBLE)
_set_iterations = setter("PhysicsParamSetNumSolverIterations", INT)
_set_residual = setter("PhysicsParamSetSolverResidualThreshold", DOUBLE)
_load_urdf = function("LoadUrdfCommandInit", POINTER, POINTER, ctypes.c_char_p)
_set_fixed_base = setter("LoadUrdfCommandSetUseFixedBase", INT)
_set_load_flags = setter("LoadUrdfCommandSetFlags", INT)
_loaded_body = function("GetStatusBodyIndex", INT, POINTER)
_number_of_joints = function("GetNumJoints", INT, POINTER, INT)
_joint_info = function("GetJointInfo", INT, POINTER, INT, INT, POINTER)
_dynamics = function("InitChangeDynamicsInfo", POINTER, POINTER)
_set_linear_damping = setter("ChangeDynamicsInfoSetLinearDamping", INT, DOUBLE)
_set_angular_damping = setter("ChangeDynamicsInfoSetAngularDamping", INT, DOUBLE)
_set_joint_damping = setter("ChangeDynamicsInfoSetJointDamping", INT, INT, DOUBLE)
_set_mass = setter("ChangeDynamicsInfoSetMass", INT, INT, DOUBLE)
_set_inertia = setter("ChangeDynamicsInfoSetLocalInertiaDiagonal", INT, INT, POINTER)
_pose = function("CreatePoseCommandInit", POINTER, POINTER, INT)
_set_position = setter("CreatePoseCommandSetJointPosition", POINTER, INT, DOUBLE)
_set_velocity = setter("CreatePoseCommandSetJointVelocity", POINTER, INT, DOUBLE)
_control = function("JointControlCommandInit2", POINTER, POINTER, INT, INT)
_set_desired_velocity = setter("JointControlSetDesiredVelocity", INT, DOUBLE)
_set_velocity_gain = setter("JointControlSetKd", INT, DOUBLE)
_set_largest_force = setter("JointControlSetMaximumForce", INT, DOUBLE)

# The same interface for compiled code, where a handle is an unsigned integer.
can_submit = c_function(LIBRARY, "b3CanSubmitCommand", "intc", "uintp")
_submit_and_wait = c_function(
    LIBRARY, "b3SubmitClientCommandAndWaitStatus", "uintp", "uintp", "uintp"
)
_send = c_function(LIBRARY, "b3SubmitClientCommand", "intc", "uintp", "uintp")
_answer = c_function(LIBRARY, "b3ProcessServerStatus", "uintp", "uintp")
control = c_function(LIBRARY, "b3JointControlCommandInit2", "uintp", "uintp", "intc", "intc")
set_torque = c_function(
    LIBRARY, "b3JointControlSetDesiredForceTorque", "intc", "uintp", "intc", "float64"
)
step_simulation = c_function(LIBRARY, "b3InitStepSimulationCommand", "uintp", "uintp")
request_state = c_function(LIBRARY, "b3RequestActualStateCommandInit", "uintp", "uintp", "intc")
get_state = c_function(LIBRARY, "b3GetStatusActualState", "intc", *["uintp"] * 8)
copy_memory = c_function(ctypes.CDLL(None), "memcpy", "uintp", "uintp", "uintp", "uintp")


@compiled
def submit(server: int, command: int, has_window: bool) -> int:
    """Execute a command; return its status, 0 if the server is gone.

    A server without a window executes a command while it is sent. Bullet's own function would still
    read the clock three times, which makes a substep a fifteenth more expensive.
    """
    status: int
    if has_window:
        status = _submit_and_wait(server, command)
    else:
        _send(server, command)
        status = _answer(server)
    return status


def shapes(*, gui: bool) -> Shapes:
    """Choose the shapes that a URDF must contain: physics alone needs none."""
    return "drawable" if gui else "none"


def no_answer() -> ConnectionError:
    """Return the error for a server that is gone, for instance because its window was closed."""
    return ConnectionError("Bullet's physics server does not answer")


class BulletServer:
    """A physics server with one arm on a fixed base, without Bullet's own damping.

    Args:
        specification: the arm to build. A window needs a display.

    Attributes:
        handle: the server, as Bullet's functions take it.
        body: the arm, as Bullet's functions take it.
        joints: the arm's joints, in the order of `RobotDescription.joint_names`.

    Raises:
        RobotDescriptionError: Bullet cannot load the arm.
    """

    def __init__(self, specification: ArmSpecification) -> None:
        robot, gui = specification.robot, specification.gui
        with quiet():
            self.handle: int = _connect_window(0, None) if gui else _connect()
        reset = _reset(self.handle)
        # One body never touches anything: looking for contacts would be a tenth of a step.
        _set_reset_flags(reset, _USE_SIMPLE_BROADPHASE)
        self._carry_out(reset)
        try:
            urdf = robot.resolved_urdf(specification.loaded_kg, shapes(gui=gui))
            self.body = _load(self.handle, robot.path, urdf)
        except RobotDescriptionError:
            self.close()
            raise
        names = self._link_names()
        self.joints = [names[name][0] for name in robot.joint_names]
        self._payload_links = [
            joint.link for joint, link_name in names.values() if link_name == PAYLOAD_LINK
        ]
        if specification.loaded_kg != specification.payload_kg:
            self.carry(specification.payload_kg)
        substep_s = specification.grid.substep_s
        self._set_up_world(substep_s, len(names), iterates=bool(robot.followers))
        self._followers = [
            (names[each.name][0], robot.joint_names.index(each.leader), each)
            for each in robot.followers
        ]
        for joint, leader, follower in self._followers:
            links = joint.link, self.joints[leader].link
            tie(self.handle, self.body, links, follower, self._carry_out)

    def place(self, position: Vector) -> None:
        """Put the joints at `position` (rad, shape (joints,)), at rest."""
        placed = list(zip(self.joints, position.tolist(), strict=True))
        for joint, leader, follower in self._followers:
            angle = follower.multiplier * float(position[leader]) + follower.offset
            placed.append((joint, angle))
        for joint, angle in placed:
            pose = _pose(self.handle, self.body)
            _set_position(self.handle, pose, joint.link, angle)
            _set_velocity(self.handle, pose, joint.link, 0.0)
            self._carry_out(pose)

    def hold_with(self, torques_nm: Sequence[float]) -> None:
        """Hold each joint at rest with at most this torque; 0 releases it."""
        motors = _control(self.handle, self.body, CONTROL_VELOCITY)
        # followers move with their leaders, but every joint has a motor at first
        free = [(joint, 0.0) for joint, _, _ in self._followers]
        for joint, torque_nm in [*zip(self.joints, torques_nm, strict=True), *free]:
            _set_desired_velocity(motors, joint.velocity_index, 0.0)
            _set_velocity_gain(motors, joint.velocity_index, 1.0)
            _set_largest_force(motors, joint.velocity_index, torque_nm)
        self._carry_out(motors)

    def carry(self, payload_kg: float) -> None:
        """Carry this point mass at the tip from now on; the specification must announce it.

        It arrives with the velocity of the tip: joint velocities do not change.
        """
        for link in self._payload_links:
            change = _dynamics(self.handle)
            _set_mass(change, self.body, link, payload_kg)
            # by default, Bullet derives an inertia from the link's extent
            _set_inertia(change, self.body, link, (DOUBLE * 3)())
            self._carry_out(change)

    def close(self) -> None:
        """Free the server."""
        _disconnect(self.handle)

    def _carry_out(self, command: int) -> int:
        """Execute a command; return its status.

        Raises:
            ConnectionError: the server is gone.
        """
        if not _can_submit(self.handle):
            raise no_answer()
        status: int = _submit(self.handle, command)
        return status

    def _link_names(self) -> dict[str, tuple[Joint, str]]:
        """Return joint and link by name of the joint."""
        by_name = {}
        info = JointInfo()
        for link in range(_number_of_joints(self.handle, self.body)):
            _joint_info(self.handle, self.body, link, ctypes.addressof(info))
            joint = Joint(link, info.position_index, info.velocity_index)
            by_name[info.joint_name.decode()] = (joint, info.link_name.decode())
        return by_name

    def _set_up_world(self, substep_s: float, links: int, *, iterates: bool) -> None:
        world = _world(self.handle)
        _set_gravity(world, 0.0, 0.0, -GRAVITY_M_S2)
        _set_time_step(world, substep_s)
        if iterates:  # otherwise gears are only half solved
            _set_iterations(world, _MOST_ITERATIONS)
            _set_residual(world, 0.0)
        self._carry_out(world)
        for link in range(_BASE_LINK, links):
            change = _dynamics(self.handle)
            _set_linear_damping(change, self.body, 0.0)
            _set_angular_damping(change, self.body, 0.0)
            _set_joint_damping(change, self.body, link, 0.0)
            self._carry_out(change)


@lru_cache(maxsize=16)
def require_loadable(path: Path, urdf: str) -> None:
    """Check that Bullet can load an arm; a successful check is not repeated.

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
    """Provide the URDF as a file for Bullet, and suppress all output on the terminal.

    Args:
        path: the arm's file, whose name it gets.
        urdf: `RobotDescription.resolved_urdf`.
    """
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / path.name
        file.write_text(urdf, encoding="utf-8")
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
