"""A drive with the MIT protocol: motor mode, the loop it closes, timeout, errors."""

from __future__ import annotations

import math

from bus_schema.can.frame import CanFrame, is_data
from bus_schema.can.mit.codec import (
    COMMAND_BYTES,
    MitCommand,
    MitError,
    MitReply,
    Special,
    command_of,
    is_command,
    is_reply,
    packed_reply,
    reply_of,
    special_of,
)
from bus_schema.can.mit.protocol import MitSettings
from bus_schema.errors import InvalidMessageError
from plant_emulator.drives.cascade import CascadeLoop
from plant_emulator.drives.drive import (
    AT_REST,
    Drive,
    DriveFault,
    DriveSettings,
    JointDemand,
    JointLoop,
    Loop,
    Send,
    following,
)

_MS = 1_000_000
_USUAL_C, _HOT_C = 25, 110
_TURN_RAD = 2.0 * math.pi
_ERRORS = {
    None: MitError.NONE,
    DriveFault.DRIVE: MitError.OVER_CURRENT,
    DriveFault.OVER_TEMPERATURE: MitError.OVER_TEMPERATURE,
    DriveFault.ENCODER: MitError.ENCODER,
}


class LoopDrive(Drive):
    """A drive that closes the loop of its last command around its own zero, and rests without."""

    targets = samplings = 0

    def __init__(self, settings: DriveSettings, send: Send) -> None:
        super().__init__(settings, send)
        self._step_rad = _TURN_RAD / settings.counts_per_turn
        self._zero_rad = 0.0
        self._loop: Loop | None = None
        self._heard_ns = 0

    @property
    def position_rad(self) -> float:
        """Encoder values, relative to the drive's zero."""
        seen_rad = round(self._reading.position_rad / self._step_rad) * self._step_rad
        return seen_rad - self._zero_rad

    @property
    def temperature_c(self) -> int:
        """State of power stage and motor."""
        return _HOT_C if self._is_hot else _USUAL_C

    def demand(self) -> JointDemand:
        return AT_REST if self._loop is None else following(self._loop, self._reading)

    def _make_zero(self) -> None:
        """Define the present position as zero; a command in force refers to the new zero."""
        moved_rad = self.position_rad
        self._zero_rad += moved_rad
        if isinstance(self._loop, JointLoop | CascadeLoop):
            self._loop = self._loop._replace(target_rad=self._loop.target_rad + moved_rad)

    def _mit_loop(self, command: MitCommand, most_nm: float) -> JointLoop:
        """Return the loop of a command, at the joint, with the largest available torque."""
        target_rad = command.position_rad + self._zero_rad
        return JointLoop(target_rad, *command[1:], step_rad=self._step_rad, most_nm=most_nm)

    def _state(self, error: int) -> MitReply:
        """Return the reported values."""
        return MitReply(
            self._settings.node_id, self.position_rad, self._reading.velocity_rad_s,
            self._reading.torque_nm, self.temperature_c, error,
        )  # fmt: skip


class MitDrive(LoopDrive):
    """One drive, see `Drive`; position and torque are the joint's."""

    def __init__(self, settings: DriveSettings, send: Send) -> None:
        super().__init__(settings, send)
        self.heard = (settings.node_id,)
        own = settings.own
        self._own = own if isinstance(own, MitSettings) else MitSettings()
        self._ranges = self._own.ranges
        self._most_nm = min(settings.max_torque_nm, self._ranges.torque_nm)
        self._is_in_motor_mode = self._is_timed_out = False
        self._error = MitError.NONE

    @property
    def status(self) -> str:
        return "MOTOR MODE" if self._is_in_motor_mode else "REST MODE"

    @property
    def fault(self) -> str | None:
        if self._error is not MitError.NONE:
            return f"{self._error.name} (error {self._error})"
        return "command timeout" if self._is_timed_out else None

    def receive(self, frame: CanFrame, now_ns: int) -> bool:
        if self._is_off_bus or frame.identifier != self._settings.node_id:
            return False
        if is_command(frame):
            self._take(command_of(frame.data, self._ranges))
        elif is_data(frame, COMMAND_BYTES):
            self._change(special_of(frame.data), frame)
        else:
            raise InvalidMessageError("no_command", f"drives have no use for {frame}")
        self._heard_ns = now_ns
        self._reply()
        return True

    def advance(self, now_ns: int) -> None:
        timeout_ns = self._settings.watchdog_ms * _MS
        if timeout_ns and self._loop is not None and now_ns - self._heard_ns > timeout_ns:
            self._is_timed_out = True
            self._rest()

    def _fail(self, fault: DriveFault, now_ns: int) -> None:  # noqa: ARG002 (the interface)
        self._error = _ERRORS[fault]
        self._rest()

    def describe(self, frame: CanFrame) -> str | None:
        node_id = self._settings.node_id
        if frame.identifier == node_id:
            if is_command(frame):
                return f"drive {node_id} " + _in_words(command_of(frame.data, self._ranges))
            kind = special_of(frame.data) if is_data(frame, COMMAND_BYTES) else None
            return f"drive {node_id} " + ("no command" if kind is None else kind.name.lower())
        is_answer = frame.identifier == self._own.reply_identifier and is_reply(frame)
        if is_answer and frame.data[0] == node_id:
            return "reply " + _in_words(reply_of(frame.data, self._ranges))
        return None

    def _take(self, command: MitCommand) -> None:
        """A command counts in motor mode only, and stays in force until the next one."""
        self.targets += 1
        if self._is_in_motor_mode:
            self._loop = self._mit_loop(command, self._most_nm)

    def _change(self, kind: Special | None, frame: CanFrame) -> None:
        if kind in (None, Special.CLEAR_ERROR):
            raise InvalidMessageError("no_command", f"drives have no use for {frame}")
        if kind is Special.ZERO:
            self._make_zero()
            return
        self.samplings += 1
        self._is_timed_out = False
        if kind is Special.DISABLE:
            self._rest()
            self._error = _ERRORS[self._lasting_fault]
        elif self._error is MitError.NONE:
            self._is_in_motor_mode = True

    def _rest(self) -> None:
        self._is_in_motor_mode, self._loop = False, None

    def _reply(self) -> None:
        data = packed_reply(self._state(self._error), self._ranges, self._own.reply_bytes)
        self._transmit(CanFrame(self._own.reply_identifier, data))


def _in_words(values: MitCommand | MitReply) -> str:
    return ", ".join(f"{name} {value:.5g}" for name, value in values._asdict().items())
