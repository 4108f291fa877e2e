"""A drive that closes the loop of its last command: zero, rounding, watchdog."""

from __future__ import annotations

import math
from abc import abstractmethod
from collections.abc import Sequence

from bus_schema.can.codec import AxisState
from plant_emulator.drives.cascade import CascadeLoop
from plant_emulator.drives.drive import (
    AT_REST,
    Drive,
    DriveSettings,
    JointDemand,
    JointLoop,
    Loop,
    Own,
    Send,
    following,
)

_MS = 1_000_000
_USUAL_C = 25


class LoopDrive(Drive[Own]):
    """A drive that closes a loop around its joint, and rests without one.

    Attributes:
        hot_c: reported temperature of an overheated motor.
    """

    targets = samplings = 0
    hot_c = 110

    def __init__(self, settings: DriveSettings[Own], send: Send) -> None:
        super().__init__(settings, send)
        self._step_rad = 2.0 * math.pi / settings.counts_per_turn
        self._zero_rad = 0.0
        self._loop: Loop | None = None
        self._fed_ns = 0  # time of the last valid frame

    @property
    def position_rad(self) -> float:
        """Position in whole increments of the encoder, relative to the drive's zero."""
        seen_rad = round(self._reading.position_rad / self._step_rad) * self._step_rad
        return seen_rad - self._zero_rad

    @property
    def temperature_c(self) -> int:
        """Temperature of power stage and motor."""
        return self.hot_c if self._is_hot else _USUAL_C

    @property
    def timeout_ns(self) -> float:
        """Longest time without a valid frame while the loop is closed; 0 or NaN for no limit."""
        return self._settings.watchdog_ms * _MS

    def demand(self) -> JointDemand:
        return AT_REST if self._loop is None else following(self._loop, self._reading)

    def advance(self, now_ns: int) -> None:
        timeout_ns = self.timeout_ns
        if timeout_ns and self._loop is not None and now_ns - self._fed_ns > timeout_ns:
            self._time_out()

    @abstractmethod
    def _time_out(self) -> None:
        """React to the expired watchdog."""

    def _set_position(self, position_rad: float) -> None:
        """Move the zero so that the present position becomes this value."""
        self._zero_rad += self.position_rad - position_rad

    def _make_zero(self) -> None:
        """Define the present position as zero; a command in force refers to the new zero."""
        moved_rad = self.position_rad
        self._zero_rad += moved_rad
        if isinstance(self._loop, JointLoop | CascadeLoop):
            self._loop = self._loop._replace(target_rad=self._loop.target_rad + moved_rad)

    def _joint_loop(self, command: Sequence[float], most_nm: float) -> JointLoop:
        """Return the loop of a command.

        Args:
            command: position relative to the drive's zero, velocity, stiffness, damping, torque.
            most_nm: largest torque.
        """
        position, velocity, stiffness, damping, torque_nm = command
        return JointLoop(
            position + self._zero_rad, velocity, stiffness, damping, torque_nm,
            self._step_rad, most_nm,
        )  # fmt: skip

    def _state(self, error: int) -> AxisState:
        """Return the state that the drive reports."""
        return AxisState(
            self._settings.node_id, self.position_rad, self._reading.velocity_rad_s,
            self._reading.torque_nm, self.temperature_c, error,
        )  # fmt: skip
