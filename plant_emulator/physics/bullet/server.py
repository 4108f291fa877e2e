"""Bullet's C interface in pybullet's library: a physics server with one arm.

pybullet's Python functions build lists, tuples and dictionaries around each of these calls, and
Python has to call them in every substep; compiled code can call the C functions directly
(`arm.py`). Both call the same functions, so they give the same bits.
"""

from __future__ import annotations

import ctypes
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from functools import lru_cache
from pathlib import Path
from typing import NamedTuple

from bus_schema.arrays import Vector
from bus_schema.errors import RobotDescriptionError
from bus_schema.robot_description import Shapes
from bus_schema.runtime.compiled import c_function, compiled
from bus_schema.urdf.joints import Follower
from bus_schema.urdf.resolved import PAYLOAD_JOINT
from plant_emulator.physics.bullet.library import (
    DOUBLE,
    LIBRARY,
    Handle,
    JointInfo,
    call,
    handle,
    quiet,
)
from plant_emulator.physics.engine import ArmSpecification

_GEAR = 6
_LARGEST_FORCE = 1e9

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


# Functions for compiled code, where a handle is an unsigned integer.
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
            self.handle = (
                handle("CreateInProcessPhysicsServerAndConnect", 0, None)
                if gui
                else handle("ConnectPhysicsDirect")
            )
        reset = self._new("InitResetSimulationCommand")
        # One body never touches anything: looking for contacts would be a tenth of a step.
        call("InitResetSimulationSetFlags", reset, _USE_SIMPLE_BROADPHASE)
        self._carry_out(reset)
        try:
            urdf = robot.resolved_urdf(specification.loaded_kg, shapes(gui=gui))
            self.body = _load(self.handle, robot.path, urdf)
        except RobotDescriptionError:
            self.close()
            raise
        self._robot, self._links = robot, self._joints_by_name()
        self.joints = [self._links[name] for name in robot.joint_names]
        if specification.loaded_kg != specification.payload_kg:
            self.carry(specification.payload_kg)
        substep_s = specification.grid.substep_s
        self._set_up_world(substep_s, len(self._links), iterates=bool(robot.followers))
        for follower in robot.followers:
            self._tie(follower)

    def place(self, position: Vector) -> None:
        """Put the joints at `position` (rad, shape (joints,)), at rest."""
        for name, angle in self._robot.joint_positions(position).items():
            link, pose = self._links[name].link, self._new("CreatePoseCommandInit", self.body)
            call("CreatePoseCommandSetJointPosition", self.handle, pose, link, angle)
            call("CreatePoseCommandSetJointVelocity", self.handle, pose, link, 0.0)
            self._carry_out(pose)

    def hold_with(self, torques_nm: Sequence[float]) -> None:
        """Hold each joint at rest with at most this torque; 0 releases it."""
        motors = self._new("JointControlCommandInit2", self.body, CONTROL_VELOCITY)
        # followers move with their leaders, but every joint has a motor at first
        free = [(self._links[each.name], 0.0) for each in self._robot.followers]
        for joint, torque_nm in [*zip(self.joints, torques_nm, strict=True), *free]:
            call("JointControlSetDesiredVelocity", motors, joint.velocity_index, 0.0)
            call("JointControlSetKd", motors, joint.velocity_index, 1.0)
            call("JointControlSetMaximumForce", motors, joint.velocity_index, torque_nm)
        self._carry_out(motors)

    def carry(self, payload_kg: float) -> None:
        """Carry this point mass at the tip from now on; the specification must announce it.

        It arrives with the velocity of the tip: joint velocities do not change.
        """
        if (payload := self._links.get(PAYLOAD_JOINT)) is not None:
            change, link = self._new("InitChangeDynamicsInfo"), payload.link
            call("ChangeDynamicsInfoSetMass", change, self.body, link, payload_kg)
            # by default, Bullet derives an inertia from the link's extent
            none = (DOUBLE * 3)()
            call("ChangeDynamicsInfoSetLocalInertiaDiagonal", change, self.body, link, none)
            self._carry_out(change)

    def close(self) -> None:
        """Free the server."""
        call("DisconnectSharedMemory", self.handle)

    def _new(self, name: str, *arguments: object) -> Handle:
        """Return a new command for this server."""
        return handle(name, self.handle, *arguments)

    def _carry_out(self, command: Handle) -> Handle:
        """Execute a command; return its status.

        Raises:
            ConnectionError: the server is gone.
        """
        if not call("CanSubmitCommand", self.handle):
            raise no_answer()
        return _submitted(self.handle, command)

    def _tie(self, follower: Follower) -> None:
        """Couple a joint to another one: q = multiplier × q of the leader + offset.

        The solver couples their speeds in every step; an error in position decays in a few steps.
        """
        info = JointInfo(joint_type=_GEAR)
        info.parent_frame[6] = info.child_frame[6] = 1.0  # no rotation
        link, leader = (self._links[name].link for name in (follower.name, follower.leader))
        ends = (self.body, link, self.body, leader, ctypes.byref(info))
        created = self._carry_out(self._new("InitCreateUserConstraintCommand", *ends))
        number = call("GetStatusUserConstraintUniqueId", created)
        change = self._new("InitChangeUserConstraintCommand", number)
        for setting, value in {
            "GearRatio": -follower.multiplier,
            "RelativePositionTarget": follower.offset,
            "MaxForce": _LARGEST_FORCE,
            "ERP": 1.0,
        }.items():
            call(f"InitChangeUserConstraintSet{setting}", change, value)
        self._carry_out(change)

    def _joints_by_name(self) -> dict[str, Joint]:
        by_name = {}
        info = JointInfo()
        for link in range(call("GetNumJoints", self.handle, self.body)):
            call("GetJointInfo", self.handle, self.body, link, ctypes.byref(info))
            joint = Joint(link, info.position_index, info.velocity_index)
            by_name[info.joint_name.decode()] = joint
        return by_name

    def _set_up_world(self, substep_s: float, links: int, *, iterates: bool) -> None:
        world = self._new("InitPhysicsParamCommand")
        call("PhysicsParamSetGravity", world, 0.0, 0.0, -GRAVITY_M_S2)
        call("PhysicsParamSetTimeStep", world, substep_s)
        if iterates:  # otherwise gears are only half solved
            call("PhysicsParamSetNumSolverIterations", world, _MOST_ITERATIONS)
            call("PhysicsParamSetSolverResidualThreshold", world, 0.0)
        self._carry_out(world)
        for link in range(_BASE_LINK, links):
            change = self._new("InitChangeDynamicsInfo")
            call("ChangeDynamicsInfoSetLinearDamping", change, self.body, 0.0)
            call("ChangeDynamicsInfoSetAngularDamping", change, self.body, 0.0)
            call("ChangeDynamicsInfoSetJointDamping", change, self.body, link, 0.0)
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
    server = handle("ConnectPhysicsDirect")
    try:
        _load(server, path, urdf)
    finally:
        call("DisconnectSharedMemory", server)


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


def _load(server: Handle, path: Path, urdf: str) -> int:
    with loadable_file(path, urdf) as file:
        load = handle("LoadUrdfCommandInit", server, bytes(file))
        call("LoadUrdfCommandSetUseFixedBase", load, 1)
        call("LoadUrdfCommandSetFlags", load, _USE_INERTIA_FROM_FILE)
        body = call("GetStatusBodyIndex", _submitted(server, load))
    if body < 0:
        raise RobotDescriptionError(f"{path}: pybullet cannot load it")
    return body


def _submitted(server: Handle, command: Handle) -> Handle:
    """Execute a command; return its status."""
    return handle("SubmitClientCommandAndWaitStatus", server, command)
