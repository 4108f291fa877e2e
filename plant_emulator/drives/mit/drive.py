"""A drive with the MIT protocol: motor mode, the loop it closes, timeout, errors."""

from __future__ import annotations

from bus_schema.can.codec import AxisState
from bus_schema.can.frame import CanFrame, is_data
from bus_schema.can.mit.codec import (
    COMMAND_BYTES,
    MitCommand,
    MitError,
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
from plant_emulator.drives.drive import DriveFault, DriveSettings, Send
from plant_emulator.drives.loop_drive import LoopDrive

_ERRORS = {
    None: MitError.NONE,
    DriveFault.DRIVE: MitError.OVER_CURRENT,
    DriveFault.OVER_TEMPERATURE: MitError.OVER_TEMPERATURE,
    DriveFault.ENCODER: MitError.ENCODER,
}


class MitDrive(LoopDrive[MitSettings]):
    """One drive, see `Drive`; position and torque are the joint's."""

    def __init__(self, settings: DriveSettings[MitSettings], send: Send) -> None:
        super().__init__(settings, send)
        self.identifiers = (settings.node_id,)
        self._own, self._ranges = settings.own, settings.own.ranges
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
        self._fed_ns = now_ns
        self._reply()
        return True

    def _time_out(self) -> None:
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
            self._loop = self._joint_loop(command, self._most_nm)

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


def _in_words(values: MitCommand | AxisState) -> str:
    return ", ".join(f"{name} {value:.5g}" for name, value in values._asdict().items())
