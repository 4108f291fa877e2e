"""A moteus controller: modes, position mode, watchdog and faults of its firmware.

Behaviour is that of mjbots' public references of CAN protocol, registers and configuration.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from bus_schema.can.frame import CanFrame
from bus_schema.can.moteus.codec import (
    ASKS_REPLY,
    BROADCAST,
    TURN_RAD,
    Mode,
    Register,
    moteus_frame,
)
from bus_schema.errors import InvalidMessageError
from plant_emulator.drives.drive import DriveFault, DriveSettings, JointLoop, Send
from plant_emulator.drives.mit.drive import LoopDrive
from plant_emulator.drives.moteus.multiplex import (
    ErrorKind,
    Operation,
    Subframe,
    subframes,
)

_FAULTS = {
    None: 0, DriveFault.DRIVE: 33, DriveFault.ENCODER: 35, DriveFault.OVER_TEMPERATURE: 38
}  # fmt: skip
_DEFAULT_TIMEOUT_MS = 100.0
_MS, _S = 1e6, 1e9
_BUS_V, _TORQUE_CONSTANT_NM_A = 48.0, 1.0
_COMMAND: dict[int, float] = {
    Register.COMMAND_POSITION: 0.0, Register.COMMAND_VELOCITY: 0.0,
    Register.FEEDFORWARD_TORQUE: 0.0, Register.KP_SCALE: 1.0, Register.KD_SCALE: 1.0,
    Register.MAXIMUM_TORQUE: math.nan, Register.STOP_POSITION: math.nan,
    Register.WATCHDOG_TIMEOUT: 0.0, Register.VELOCITY_LIMIT: math.nan,
    Register.ACCELERATION_LIMIT: math.nan,
}  # fmt: skip
"""Registers of a command, with what holds if it has none of its own."""

_NEVER_NAN = {Register.FEEDFORWARD_TORQUE, Register.KP_SCALE, Register.KD_SCALE}
_NEVER_NEGATIVE = {
    Register.KP_SCALE, Register.KD_SCALE, Register.MAXIMUM_TORQUE, Register.WATCHDOG_TIMEOUT
}  # fmt: skip
_UNLIMITED = {Register.VELOCITY_LIMIT, Register.ACCELERATION_LIMIT}
_WRITABLE = {Register.SET_OUTPUT_NEAREST, Register.SET_OUTPUT_EXACT, *_COMMAND}


@dataclass
class MovingLoop:
    """A loop around a target that moves at the target velocity, see `drive.Loop`.

    Attributes:
        loop: as of now.
        stop_rad: where the target stops; NaN for nowhere.
    """

    loop: JointLoop
    stop_rad: float

    @property
    def is_closed(self) -> bool:
        """Whether the joint's motion changes the torque."""
        return self.loop.is_closed

    def torque_nm(self, position_rad: float, velocity_rad_s: float, step_s: float = 0.0) -> float:
        """Torque at the joint's position and velocity."""
        speed_rad_s = self.loop.target_velocity_rad_s
        target_rad = self.loop.target_rad + step_s * speed_rad_s
        if (target_rad - self.stop_rad) * speed_rad_s > 0.0:
            target_rad, speed_rad_s = self.stop_rad, 0.0
        self.loop = self.loop._replace(target_rad=target_rad, target_velocity_rad_s=speed_rad_s)
        return self.loop.torque_nm(position_rad, velocity_rad_s)


class MoteusDrive(LoopDrive):
    """One drive, see `Drive`; position and torque are the joint's."""

    most_bytes, takes_extended = 64, True

    def __init__(self, settings: DriveSettings, send: Send) -> None:
        super().__init__(settings, send)
        receivers = settings.node_id, BROADCAST
        self.heard = {*range(receivers[0], 1 << 16, 1 << 8), *range(receivers[1], 1 << 16, 1 << 8)}
        self._mode, self._fault = Mode.STOPPED, 0
        self._timeout_ns = math.nan
        self._command = _COMMAND.copy()

    @property
    def status(self) -> str:
        return self._mode.name

    @property
    def fault(self) -> str | None:
        if self._mode is Mode.FAULT:
            return f"fault {self._fault}"
        return "command timeout (mode 11)" if self._mode is Mode.TIMEOUT else None

    def receive(self, frame: CanFrame, now_ns: int) -> bool:
        if self._is_off_bus:
            return False
        asked = subframes(frame.data)
        if frame.is_remote or any(each.operation is Operation.REPLY for each in asked):
            raise InvalidMessageError("no_command", f"drives have no use for {frame}")
        written = [row for each in asked for row in zip(each.registers, each.values, strict=False)]
        refused = next((register for register, value in written if not _may(register, value)), None)
        asks_reply = bool(frame.identifier & ASKS_REPLY)
        if refused is None:
            self._write(written, now_ns, asks_reply=asks_reply)
        if asks_reply:
            error = b"" if refused is None else ErrorKind.WRITE.packed(refused)
            self._reply(frame.identifier >> 8 & 0x7F, asked, error)
        if refused is not None:
            raise InvalidMessageError("not_there", f"register {refused:#x} cannot get its value")
        return True

    def advance(self, now_ns: int) -> None:
        is_overdue = now_ns - self._heard_ns > self._timeout_ns  # never, if that is NaN
        if self._mode is Mode.POSITION and is_overdue:
            self._mode, self._loop = Mode.TIMEOUT, self._loop_at_rest(1.0)

    def _fail(self, fault: DriveFault, now_ns: int) -> None:  # noqa: ARG002 (the interface)
        self._mode, self._fault, self._loop = Mode.FAULT, _FAULTS[fault], None

    def describe(self, frame: CanFrame) -> str | None:
        node_id = self._settings.node_id
        if frame.identifier not in self.heard and frame.identifier >> 8 != node_id:
            return None
        try:
            return f"drive {node_id} " + "; ".join(map(_in_words, subframes(frame.data)))
        except InvalidMessageError as error:
            return f"drive {node_id}: {error}"

    def _write(
        self, written: Sequence[tuple[int, float]], now_ns: int, *, asks_reply: bool
    ) -> None:
        """Set registers; a mode makes them a command, and forgets those before it."""
        mode: Mode | None = None
        for register, value in written:
            if register == Register.MODE:
                mode, self._command = Mode(int(value)), _COMMAND.copy()
            elif register in _COMMAND:
                self._command[register] = value
            else:
                moved = value - self.position_rad / TURN_RAD
                moved = round(moved) if register == Register.SET_OUTPUT_NEAREST else moved
                self._zero_rad -= moved * TURN_RAD
        if mode is None:
            return
        # A stop that asks for the state samples it, and another one is the command.
        self.targets += mode is not Mode.STOPPED or not asks_reply
        self._heard_ns = now_ns
        if mode is Mode.STOPPED:
            self._mode, self._fault, self._loop = mode, 0, None
        elif self._mode not in (Mode.FAULT, Mode.TIMEOUT):
            self._start(mode, now_ns)

    def _start(self, mode: Mode, now_ns: int) -> None:
        if self._lasting_fault is not None:
            self._fail(self._lasting_fault, now_ns)
            return
        command, before = self._command, self._loop
        if mode is Mode.POSITION:
            held = before.loop.target_rad if isinstance(before, MovingLoop) else None
            self._loop = self._moving_loop(self._reading.position_rad if held is None else held)
        else:
            self._loop = self._loop_at_rest(command[Register.KD_SCALE])
        self._mode = mode
        timeout_ms = self._settings.watchdog_ms or _DEFAULT_TIMEOUT_MS
        self._timeout_ns = command[Register.WATCHDOG_TIMEOUT] * _S or timeout_ms * _MS

    def _moving_loop(self, held_rad: float) -> MovingLoop:
        """The loop of the command, around `held_rad` if it has no position."""
        command, gains = self._command, self._settings.gains
        position, stop = command[Register.COMMAND_POSITION], command[Register.STOP_POSITION]
        velocity, most_nm = command[Register.COMMAND_VELOCITY], command[Register.MAXIMUM_TORQUE]
        largest_nm = self._settings.max_torque_nm
        loop = JointLoop(
            held_rad if math.isnan(position) else position * TURN_RAD + self._zero_rad,
            0.0 if math.isnan(velocity) else velocity * TURN_RAD,
            command[Register.KP_SCALE] * gains.position_1_s * gains.velocity_nm_s,
            command[Register.KD_SCALE] * gains.velocity_nm_s,
            command[Register.FEEDFORWARD_TORQUE], self._step_rad,
            largest_nm if math.isnan(most_nm) else min(most_nm, largest_nm),
        )  # fmt: skip
        return MovingLoop(loop, stop * TURN_RAD + self._zero_rad)

    def _loop_at_rest(self, kd_scale: float) -> JointLoop:
        """A damper."""
        damping = kd_scale * self._settings.gains.velocity_nm_s
        return JointLoop(0.0, 0.0, 0.0, damping, 0.0, self._step_rad, self._settings.max_torque_nm)

    def _reply(self, receiver: int, asked: Sequence[Subframe], data: bytes) -> None:
        """Answer the reading subframes, up to one with a register that is not there."""
        known = self._values()
        for each in asked:
            if each.operation is not Operation.READ:
                continue
            unknown = next((register for register in each.registers if register not in known), None)
            if unknown is not None:
                data += ErrorKind.READ.packed(unknown)
                break
            data += each.packed_reply(known)
            self.samplings += Register.POSITION in each.registers
        if len(data) > self.most_bytes:
            raise InvalidMessageError("too_long", f"an answer of {len(data)} bytes")
        self._transmit(moteus_frame(self._settings.node_id << 8 | receiver, data))

    def _values(self) -> Mapping[int, float]:
        """Registers that can be read."""
        return self._command | {
            Register.MODE: self._mode, Register.FAULT: self._fault,
            Register.POSITION: self.position_rad / TURN_RAD,
            Register.VELOCITY: self._reading.velocity_rad_s / TURN_RAD,
            Register.TORQUE: self._reading.torque_nm,
            Register.Q_CURRENT: self._reading.torque_nm / _TORQUE_CONSTANT_NM_A,
            Register.D_CURRENT: 0.0, Register.VOLTAGE: _BUS_V, Register.TRAJECTORY_COMPLETE: 1,
            Register.TEMPERATURE: self.temperature_c,
            Register.MOTOR_TEMPERATURE: self.temperature_c,
        }  # fmt: skip


def _may(register: int, value: float) -> bool:
    """Whether an emulated drive can do what a written register asks for."""
    if register == Register.MODE:
        return value in (Mode.STOPPED, Mode.POSITION, Mode.ZERO_VELOCITY)
    if register in _UNLIMITED:
        return math.isnan(value) or value < 0.0
    if math.isnan(value):
        return register in _COMMAND and register not in _NEVER_NAN
    is_negative = register in _NEVER_NEGATIVE and value < 0.0
    return register in _WRITABLE and math.isfinite(value) and not is_negative


def _in_words(subframe: Subframe) -> str:
    names = {int(each): each.name for each in Register}
    words = [names.get(register, hex(register)) for register in subframe.registers]
    words = [
        f"{name} {value:.5g}" for name, value in zip(words, subframe.values, strict=False)
    ] or words
    return f"{subframe.operation.name.lower()} " + ", ".join(words)
