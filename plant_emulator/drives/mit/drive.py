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
)
from bus_schema.can.mit.protocol import MitSettings
from bus_schema.errors import InvalidMessageError
from plant_emulator.drives.drive import (
    AT_REST,
    Drive,
    DriveFault,
    DriveSettings,
    JointDemand,
    JointLoop,
    Send,
)

_MS = 1_000_000
_USUAL_C, _HOT_C = 25, 110
_TURN_RAD = 2.0 * math.pi


class MitDrive(Drive):
    """One drive, see `Drive`; position and torque are the joint's."""

    targets = samplings = 0

    def __init__(self, settings: DriveSettings, send: Send) -> None:
        super().__init__(settings, send)
        self.heard = (settings.node_id,)
        own = settings.own
        self._own = own if isinstance(own, MitSettings) else MitSettings()
        self._ranges = self._own.ranges
        self._step_rad = _TURN_RAD / settings.counts_per_turn
        self._most_nm = min(settings.max_torque_nm, self._ranges.torque_nm)
        self._zero_rad = 0.0
        self._is_in_motor_mode = self._is_timed_out = False
        self._command: MitCommand | None = None
        self._error = MitError.NONE
        self._heard_ns = 0

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
        elif (kind := _special_of(frame)) is not None:
            self._change(kind)
        else:
            raise InvalidMessageError("no_command", f"drives have no use for {frame}")
        self._heard_ns = now_ns
        self._reply()
        return True

    def advance(self, now_ns: int) -> None:
        timeout_ns = self._settings.watchdog_ms * _MS
        if timeout_ns and self._command is not None and now_ns - self._heard_ns > timeout_ns:
            self._is_timed_out = True
            self._rest()

    def demand(self) -> JointDemand:
        if self._command is None:
            return AT_REST
        loop = mit_loop(self._command, self._zero_rad, self._step_rad, self._most_nm)
        is_closed = loop.stiffness_nm_rad > 0.0 or loop.damping_nm_s > 0.0
        torque_nm = loop.torque_nm(*self._reading[:2])
        return JointDemand(torque_nm, is_released=True, loop=loop if is_closed else None)

    def _fail(self, fault: DriveFault, now_ns: int) -> None:  # noqa: ARG002 (the interface)
        hot, short = MitError.OVER_TEMPERATURE, MitError.OVER_CURRENT
        self._error = hot if fault is DriveFault.OVER_TEMPERATURE else short
        self._rest()

    def describe(self, frame: CanFrame) -> str | None:
        node_id = self._settings.node_id
        if frame.identifier == node_id:
            if is_command(frame):
                return f"drive {node_id} " + _in_words(command_of(frame.data, self._ranges))
            kind = _special_of(frame)
            return f"drive {node_id} " + ("no command" if kind is None else kind.name.lower())
        is_answer = frame.identifier == self._own.reply_identifier and is_reply(frame)
        if is_answer and frame.data[0] == node_id:
            return "reply " + _in_words(reply_of(frame.data, self._ranges))
        return None

    def _take(self, command: MitCommand) -> None:
        """A command counts in motor mode only, and stays in force until the next one."""
        self.targets += 1
        if self._is_in_motor_mode:
            self._command = command

    def _change(self, kind: Special) -> None:
        if kind is Special.ZERO:
            self._zero_rad = self._reading.position_rad
            return
        self.samplings += 1
        self._is_timed_out = False
        if kind is Special.EXIT:
            self._rest()
            self._error = MitError.OVER_TEMPERATURE if self._is_hot else MitError.NONE
        elif self._error is MitError.NONE:
            self._is_in_motor_mode = True

    def _rest(self) -> None:
        self._is_in_motor_mode = False
        self._command = None

    def _reply(self) -> None:
        node_id, reading = self._settings.node_id, self._reading
        position_rad = round(reading.position_rad / self._step_rad) * self._step_rad
        reply = MitReply(
            node_id, position_rad - self._zero_rad, reading.velocity_rad_s, reading.torque_nm,
            _HOT_C if self._is_hot else _USUAL_C, self._error,
        )  # fmt: skip
        data = packed_reply(reply, self._ranges, self._own.reply_bytes)
        self._transmit(CanFrame(self._own.reply_identifier, data))


def mit_loop(command: MitCommand, zero_rad: float, step_rad: float, most_nm: float) -> JointLoop:
    """The loop that a command wants, at the joint.

    Args:
        command: the command.
        zero_rad: where the drive's zero is.
        step_rad: resolution of its encoder.
        most_nm: the most torque there is.
    """
    return JointLoop(
        command.position_rad + zero_rad, command.velocity_rad_s, command.stiffness_nm_rad,
        command.damping_nm_s, command.torque_nm, step_rad, most_nm,
    )  # fmt: skip


def _special_of(frame: CanFrame) -> Special | None:
    if not is_data(frame, COMMAND_BYTES) or is_command(frame):
        return None
    return next((kind for kind in Special if kind == frame.data[-1]), None)


def _in_words(values: MitCommand | MitReply) -> str:
    return ", ".join(f"{name} {value:.5g}" for name, value in values._asdict().items())
