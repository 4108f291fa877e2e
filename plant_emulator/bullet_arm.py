"""The arm's rigid-body physics: Bullet, with all torques that act on the joints in each substep."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from bus_schema.arrays import Matrix, Offsets, Vector
from bus_schema.compiled import compiled
from bus_schema.robot_description import RobotDescription
from plant_emulator.bullet_server import (
    CONTROL_TORQUE,
    BulletServer,
    can_submit,
    control,
    copy_memory,
    get_state,
    request_state,
    set_torque,
    step_simulation,
    submit,
)
from plant_emulator.joint_torques import JointTorques, Tables, act

_BRAKE_TO_EFFORT = 10.0
_BRAKE_TORQUE_NM = 10_000.0
_DOUBLE_BYTES = 8


class BulletArm:
    """An arm whose substeps are gone through in compiled code, several in one call.

    Args:
        robot: description of the arm.
        substep_s: length of one physics step.
        payload_kg: point mass at the tip.
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
        substep_s: float,
        *,
        payload_kg: float = 0.0,
        gui: bool = False,
    ) -> None:
        self._server = BulletServer(robot, substep_s, payload_kg=payload_kg, gui=gui)
        self._brake_torques = [
            _BRAKE_TO_EFFORT * limit if np.isfinite(limit) else _BRAKE_TORQUE_NM
            for limit in robot.effort_limits_nm
        ]
        joints = self._server.joints
        self._indices = np.array(
            [[joint.position_index for joint in joints], [joint.velocity_index for joint in joints]]
        )
        self._state_pointers = np.zeros(2, np.uintp)
        self.motion: Matrix = np.zeros((2, robot.joints))
        self.position: Vector = self.motion[0]
        self.velocity: Vector = self.motion[1]
        self.drop_payload = self._server.drop_payload
        self.close = self._server.close
        self.set_brakes(engaged=False)

    def place(self, position: Vector) -> None:
        """Put the joints at `position` (rad, shape (joints,)), at rest."""
        self._server.place(position)
        self._require(_read(*self._arm(), self.motion))

    def set_brakes(self, *, engaged: bool) -> None:
        """Engage or release brakes that hold every joint against ten times its largest torque."""
        self.hold([engaged] * len(self._brake_torques))

    def hold(self, joints: Sequence[bool]) -> None:
        """Engage the brakes of some joints, shape (joints,), and release those of the others."""
        self._server.hold(
            [
                torque if is_held else 0.0
                for torque, is_held in zip(self._brake_torques, joints, strict=True)
            ]
        )

    def advance(
        self,
        torques: JointTorques,
        commanded_nm: Vector,
        tick_ns: int,
        offsets_ns: Offsets,
    ) -> None:
        """Go through substeps under a commanded torque, and read the joints after each.

        Args:
            torques: what makes of it the torque that acts.
            commanded_nm: shape (joints,), N m.
            tick_ns: beginning of the tick.
            offsets_ns: beginnings of the substeps after that of the tick, shape (substeps,).

        Raises:
            ConnectionError: Bullet's physics server is gone, as when its window was closed.
        """
        is_done, torques.saturated, hits = _advance(
            *self._arm(), self.motion, commanded_nm, tick_ns, offsets_ns, torques.tables
        )
        torques.hits |= hits
        self._require(is_done)

    def coast(self, substeps: int) -> None:
        """Go through substeps under no torque but that of the brakes which are engaged."""
        self._require(_coast(*self._arm(), self.motion, substeps))

    def _arm(self) -> tuple[int, int, NDArray[np.int64], NDArray[np.uintp]]:
        return self._server.handle, self._server.body, self._indices, self._state_pointers

    @staticmethod
    def _require(is_done: bool) -> None:
        if not is_done:
            raise ConnectionError("Bullet's physics server does not answer")


@compiled
def _advance(
    server: int, body: int, indices: NDArray[np.int64], pointers: NDArray[np.uintp],
    motion: Matrix, commanded: Vector, tick_ns: int, offsets_ns: Offsets, tables: Tables,
) -> tuple[bool, bool, int]:  # fmt: skip
    saturated, hits = False, 0
    for offset_ns in offsets_ns:
        time_s = (tick_ns + offset_ns) * 1e-9
        saturated, new_hits = act(commanded, motion, time_s, tables)
        hits |= new_hits
        if not can_submit(server):
            return False, saturated, hits
        motors = control(server, body, CONTROL_TORQUE)
        for i in range(commanded.size):
            set_torque(motors, indices[1, i], tables.torques[3, i])
        submit(server, motors)
        submit(server, step_simulation(server))
        if not _read(server, body, indices, pointers, motion):
            return False, saturated, hits
    return True, saturated, hits


@compiled
def _coast(
    server: int, body: int, indices: NDArray[np.int64], pointers: NDArray[np.uintp],
    motion: Matrix, substeps: int,
) -> bool:  # fmt: skip
    for _ in range(substeps):
        if not can_submit(server):
            return False
        submit(server, step_simulation(server))
    return _read(server, body, indices, pointers, motion)


@compiled
def _read(
    server: int, body: int, indices: NDArray[np.int64], pointers: NDArray[np.uintp], motion: Matrix
) -> bool:
    """Read positions and velocities; whether the server answered."""
    status = submit(server, request_state(server, body))
    first = pointers.ctypes.data
    if status == 0 or not get_state(status, 0, 0, 0, 0, first, first + _DOUBLE_BYTES, 0):
        return False
    for row in range(2):
        for i in range(indices.shape[1]):
            source = pointers[row] + _DOUBLE_BYTES * indices[row, i]
            copy_memory(motion[row, i:].ctypes.data, source, _DOUBLE_BYTES)
    return True
