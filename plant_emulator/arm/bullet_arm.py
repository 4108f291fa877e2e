"""The arm's rigid-body physics: Bullet, with all torques that act on the joints in each substep."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from bus_schema.arrays import Matrix, Vector
from bus_schema.robot_description import RobotDescription
from bus_schema.runtime.clock import TickGrid
from bus_schema.runtime.compiled import bind, compiled
from plant_emulator.arm.bullet_server import (
    CONTROL_TORQUE,
    BulletServer,
    can_submit,
    control,
    copy_memory,
    get_state,
    no_answer,
    request_state,
    set_torque,
    step_simulation,
    submit,
)
from plant_emulator.arm.joint_torques import TOTAL, JointTorques, TorqueTables, joint_torques

_BRAKE_TO_EFFORT = 10.0
_BRAKE_TORQUE_NM = 10_000.0
_DOUBLE_BYTES = 8


class Handles(NamedTuple):
    """How compiled code gets at an arm.

    Attributes:
        server: its physics server.
        body: the arm there.
        has_window: whether the server is a thread of its own, with a window.
        indices: places of its positions and of its velocities in Bullet's lists, as rows, shape
            (2, joints).
        pointers: room for the addresses of these lists, shape (2,).
    """

    server: int
    body: int
    has_window: bool
    indices: NDArray[np.int64]
    pointers: NDArray[np.uintp]


class BulletArm(BulletServer):
    """An arm on a server of its own; substeps are gone through in compiled code, several in a call.

    Args:
        robot: description of the arm.
        grid: ticks and physics steps of the run.
        torques: all that acts on the joints.
        payload_kg: point mass at the tip.
        payload_changes: whether there will be another one, see `carry`.
        gui: open Bullet's window (needs a display).

    Attributes:
        position: joint positions, rad, shape (joints,).
        velocity: joint velocities, rad/s, shape (joints,).
        motion: both as rows, shape (2, joints).

    Raises:
        RobotDescriptionError: Bullet cannot load the arm.
    """

    def __init__(
        self,
        robot: RobotDescription,
        grid: TickGrid,
        torques: JointTorques,
        *,
        payload_kg: float = 0.0,
        payload_changes: bool = False,
        gui: bool = False,
    ) -> None:
        super().__init__(
            robot, grid.substep_s, payload_kg=payload_kg, payload_changes=payload_changes, gui=gui,
            shapes="drawable" if gui else "none",
        )  # fmt: skip
        self._torques = torques
        limits = robot.effort_limits_nm
        self._brake_torques: Vector = np.where(
            np.isfinite(limits), _BRAKE_TO_EFFORT * limits, _BRAKE_TORQUE_NM
        )
        positions = [joint.position_index for joint in self.joints]
        velocities = [joint.velocity_index for joint in self.joints]
        self.motion: Matrix = np.zeros((2, robot.joints))
        self.position: Vector = self.motion[0]
        self.velocity: Vector = self.motion[1]
        indices = np.array([positions, velocities])
        handles = Handles(self.handle, self.body, gui, indices, np.zeros(2, np.uintp))
        arm = (handles, self.motion)
        self._read = bind(_read, *arm)
        self._advance_braked = bind(_advance_braked, *arm, free=["int64"])
        self._advance = bind(
            _advance, *arm, grid.period_ns, grid.substeps, torques.tables, free=["int64", "int64"]
        )
        self.set_brakes(engaged=False)

    def place(self, position: Vector) -> None:
        super().place(position)
        if not self._read():
            raise no_answer()

    def set_brakes(self, *, engaged: bool) -> None:
        """Engage or release brakes that hold every joint against ten times its largest torque."""
        self.hold([engaged] * self._brake_torques.size)

    def hold(self, joints: Sequence[bool]) -> None:
        """Engage the brakes of some joints, shape (joints,), and release those of the others."""
        self.hold_with(np.where(joints, self._brake_torques, 0.0).tolist())

    def advance(self, first: int, end: int) -> None:
        """Go through substeps under the torque that is asked for, and read the joints after each.

        Args:
            first: number of the first substep in the run.
            end: number of the first one not to go through.

        Raises:
            ConnectionError: Bullet's physics server is gone, as when its window was closed.
        """
        is_done, saturated, hits = self._advance(first, end)
        self._torques.note(saturated=saturated, hits=hits)
        if not is_done:
            raise no_answer()

    def advance_braked(self, substeps: int) -> None:
        """Go through substeps with the brakes engaged and no other torque.

        Raises:
            ConnectionError: Bullet's physics server is gone.
        """
        if not self._advance_braked(substeps):
            raise no_answer()


@compiled
def _advance(
    handles: Handles, motion: Matrix, period_ns: int, substeps: int, tables: TorqueTables,
    first: int, end: int,
) -> tuple[bool, bool, int]:  # fmt: skip
    server, body, has_window = handles.server, handles.body, handles.has_window
    saturated, hits = False, 0
    for number in range(first, end):
        time_s = (number * period_ns // substeps) * 1e-9
        saturated, new_hits = joint_torques(motion, time_s, tables)
        hits |= new_hits
        if not can_submit(server):
            return False, saturated, hits
        motors = control(server, body, CONTROL_TORQUE)
        for i in range(motion.shape[1]):
            set_torque(motors, handles.indices[1, i], tables.torques_nm[TOTAL, i])
        submit(server, motors, has_window)
        submit(server, step_simulation(server), has_window)
        if not _read(handles, motion):
            return False, saturated, hits
    return True, saturated, hits


@compiled
def _advance_braked(handles: Handles, motion: Matrix, substeps: int) -> bool:
    for _ in range(substeps):
        if not can_submit(handles.server):
            return False
        submit(handles.server, step_simulation(handles.server), handles.has_window)
    return _read(handles, motion)


@compiled
def _read(handles: Handles, motion: Matrix) -> bool:
    """Read positions and velocities; whether the server answered."""
    server, indices, pointers = handles.server, handles.indices, handles.pointers
    status = submit(server, request_state(server, handles.body), handles.has_window)
    first = pointers.ctypes.data
    if status == 0 or not get_state(status, 0, 0, 0, 0, first, first + _DOUBLE_BYTES, 0):
        return False
    for row in range(2):
        for i in range(motion.shape[1]):
            source = pointers[row] + _DOUBLE_BYTES * indices[row, i]
            copy_memory(motion[row, i:].ctypes.data, source, _DOUBLE_BYTES)
    return True
