"""The arm's rigid-body physics: Bullet, with all torques that act on the joints in each substep."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from bus_schema.arrays import Matrix, Vector
from bus_schema.robot_description import RobotDescription
from bus_schema.runtime.compiled import bind, compiled
from plant_emulator.arm.joint_torques import TOTAL, TorqueTables, joint_torques
from plant_emulator.physics.bullet.server import (
    CONTROL_TORQUE,
    BulletServer,
    can_submit,
    control,
    copy_memory,
    get_state,
    no_answer,
    request_state,
    require_loadable,
    set_torque,
    shapes,
    step_simulation,
    submit,
)
from plant_emulator.physics.engine import ArmPhysics, ArmSpecification

_BRAKE_TO_EFFORT = 10.0
_BRAKE_TORQUE_NM = 10_000.0
_DOUBLE_BYTES = 8


class Handles(NamedTuple):
    """Handles of an arm for compiled code.

    Attributes:
        server: its physics server.
        body: the arm's number on that server.
        has_window: whether the server is a separate thread with a window.
        indices: indices of its positions and velocities in Bullet's lists, as rows, shape (2,
            joints).
        pointers: buffer for the addresses of these lists, shape (2,).
    """

    server: int
    body: int
    has_window: bool
    indices: NDArray[np.int64]
    pointers: NDArray[np.uintp]


class BulletArm(ArmPhysics):
    """An arm on its own server; one call of compiled code computes several substeps.

    Raises:
        RobotDescriptionError: Bullet cannot load the arm.
    """

    def __init__(self, specification: ArmSpecification) -> None:
        super().__init__(specification)
        robot, grid, gui = specification.robot, specification.grid, specification.gui
        self._server = BulletServer(specification)
        limits = robot.effort_limits_nm
        self._brake_torques: Vector = np.where(
            np.isfinite(limits), _BRAKE_TO_EFFORT * limits, _BRAKE_TORQUE_NM
        )
        places = [(joint.position_index, joint.velocity_index) for joint in self._server.joints]
        handles = Handles(
            self._server.handle.value or 0, self._server.body, gui, np.array(places).T.copy(),
            np.zeros(2, np.uintp),
        )  # fmt: skip
        arm = (handles, self.motion)
        self._read = bind(_read, *arm)
        self._advance_braked = bind(_advance_braked, *arm, free=["int64"])
        self._advance = bind(
            _advance, *arm, grid.period_ns, grid.substeps, self._torques.tables,
            free=["int64", "int64"],
        )  # fmt: skip
        self.set_brakes(engaged=False)

    @staticmethod
    def check(robot: RobotDescription, payload_kg: float, *, gui: bool) -> None:
        """Check that Bullet can load an arm; a successful check is not repeated."""
        require_loadable(robot.path, robot.resolved_urdf(payload_kg, shapes(gui=gui)))

    def place(self, position: Vector) -> None:
        self._server.place(position)
        if not self._read():
            raise no_answer()

    def hold(self, joints: Sequence[bool]) -> None:
        """Hold joints by brakes, with ten times the joint's largest torque."""
        self._server.hold_with(np.where(joints, self._brake_torques, 0.0).tolist())

    def carry(self, payload_kg: float) -> None:
        super().carry(payload_kg)
        self._server.carry(payload_kg)

    def advance(self, first: int, end: int) -> None:
        is_done, saturated, hits = self._advance(first, end)
        self._torques.note(saturated=saturated, hits=hits)
        if not is_done:
            raise no_answer()

    def advance_braked(self, substeps: int) -> None:
        if not self._advance_braked(substeps):
            raise no_answer()

    def close(self) -> None:
        self._server.close()


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
    """Read positions and velocities; return whether the server answered."""
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
