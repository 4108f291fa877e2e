"""A moteus controller: modes, position mode, watchdog and faults.

They are those of mjbots' public references of CAN protocol, registers and configuration.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass

from bus_schema.can.frame import CanFrame
from bus_schema.can.moteus.codec import (
    ASKS_REPLY,
    BROADCAST,
    TURN_RAD,
    MoteusMode,
    MoteusRegister,
    moteus_frame,
)
from bus_schema.errors import InvalidMessageError
from plant_emulator.drives.drive import DriveFault, DriveSettings, JointLoop, Loop, Send
from plant_emulator.drives.loop_drive import LoopDrive
from plant_emulator.drives.moteus.multiplex import (
    WRITE_ERROR,
    Operation,
    packed_error,
    packed_reply,
    subframes,
)

_FAULTS = {DriveFault.DRIVE: 33, DriveFault.ENCODER: 35, DriveFault.OVER_TEMPERATURE: 38}
_DEFAULT_TIMEOUT_MS, _MS, _S = 100.0, 1e6, 1e9
_BUS_V, _TORQUE_CONSTANT_NM_A = 48.0, 1.0
_COMMAND: dict[int, float] = {
    MoteusRegister.COMMAND_POSITION: 0.0, MoteusRegister.COMMAND_VELOCITY: 0.0,
    MoteusRegister.FEEDFORWARD_TORQUE: 0.0, MoteusRegister.KP_SCALE: 1.0,
    MoteusRegister.KD_SCALE: 1.0, MoteusRegister.MAXIMUM_TORQUE: math.nan,
    MoteusRegister.STOP_POSITION: math.nan, MoteusRegister.WATCHDOG_TIMEOUT: 0.0,
}  # fmt: skip
"""Registers of a command, with what holds if it has none of its own."""

_UNLIMITED = {MoteusRegister.VELOCITY_LIMIT, MoteusRegister.ACCELERATION_LIMIT}
_WRITABLE = {
    *_COMMAND,
    *_UNLIMITED,
    MoteusRegister.SET_OUTPUT_NEAREST,
    MoteusRegister.SET_OUTPUT_EXACT,
}
_NEVER_NAN = {
    MoteusRegister.FEEDFORWARD_TORQUE, MoteusRegister.KP_SCALE, MoteusRegister.KD_SCALE,
    MoteusRegister.SET_OUTPUT_NEAREST, MoteusRegister.SET_OUTPUT_EXACT,
}  # fmt: skip
_NEVER_NEGATIVE = {
    MoteusRegister.KP_SCALE, MoteusRegister.KD_SCALE, MoteusRegister.MAXIMUM_TORQUE,
    MoteusRegister.WATCHDOG_TIMEOUT,
}  # fmt: skip


@dataclass
class MovingLoop:
    """A loop whose target moves at the target velocity, see `drive.Loop`.

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
        """Torque at the joint's position and velocity, once the target has moved on."""
        speed_rad_s = self.loop.target_velocity_rad_s
        target_rad = self.loop.target_rad + step_s * speed_rad_s
        if (target_rad - self.stop_rad) * speed_rad_s > 0.0:
            target_rad, speed_rad_s = self.stop_rad, 0.0
        self.loop = self.loop._replace(target_rad=target_rad, target_velocity_rad_s=speed_rad_s)
        return self.loop.torque_nm(position_rad, velocity_rad_s)


class MoteusDrive(LoopDrive[None]):
    """One drive, see `Drive`; position and torque are the joint's."""

    most_bytes, takes_extended = 64, True

    def __init__(self, settings: DriveSettings[None], send: Send) -> None:
        super().__init__(settings, send)
        node_ids = settings.node_id, BROADCAST
        self.identifiers = {
            each for node_id in node_ids for each in range(node_id, 1 << 16, 1 << 8)
        }
        self._mode, self._fault = MoteusMode.STOPPED, 0
        self._command, self._timeout_ns = _COMMAND.copy(), math.nan

    @property
    def status(self) -> str:
        return self._mode.name

    @property
    def fault(self) -> str | None:
        if self._mode is MoteusMode.TIMEOUT:
            return "command timeout (mode 11)"
        return f"fault {self._fault}" if self._mode is MoteusMode.FAULT else None

    def receive(self, frame: CanFrame, now_ns: int) -> bool:
        if self._is_off_bus:
            return False
        asked = subframes(frame.data)
        if frame.is_remote or any(each.operation == Operation.REPLY for each in asked):
            raise InvalidMessageError("no_command", f"drives have no use for {frame}")
        written = [row for each in asked for row in zip(each.registers, each.values, strict=False)]
        refused = next((register for register, value in written if not _may(register, value)), None)
        asks_reply = bool(frame.identifier & ASKS_REPLY)
        if refused is None:
            self._write(written, now_ns, asks_reply=asks_reply)
        if asks_reply:
            read = [each for each in asked if each.operation == Operation.READ]
            data = packed_reply(read, self._registers())
            data += b"" if refused is None else packed_error(WRITE_ERROR, refused)
            if len(data) <= self.most_bytes:  # no frame holds more
                self.samplings += any(MoteusRegister.POSITION in each.registers for each in read)
                receiver = frame.identifier >> 8 & 0x7F
                self._transmit(moteus_frame(self._settings.node_id << 8 | receiver, data))
        if refused is not None:
            raise InvalidMessageError("not_there", f"register {refused:#x} cannot get its value")
        return True

    @property
    def timeout_ns(self) -> float:
        return self._timeout_ns if self._mode is MoteusMode.POSITION else 0.0

    def _time_out(self) -> None:
        self._mode, self._loop = (
            MoteusMode.TIMEOUT,
            self._damper(self._settings.gains.velocity_nm_s),
        )

    def _fail(self, fault: DriveFault, now_ns: int) -> None:  # noqa: ARG002 (the interface)
        self._mode, self._fault, self._loop = MoteusMode.FAULT, _FAULTS[fault], None

    def describe(self, frame: CanFrame) -> str | None:
        node_id = self._settings.node_id
        if frame.identifier not in self.identifiers and frame.identifier >> 8 != node_id:
            return None
        try:
            return f"drive {node_id} " + "; ".join(map(str, subframes(frame.data)))
        except InvalidMessageError as error:
            return f"drive {node_id}: {error}"

    def _write(
        self, written: Iterable[tuple[int, float]], now_ns: int, *, asks_reply: bool
    ) -> None:
        """Set registers; a mode makes them a command, and forgets those before it."""
        mode: MoteusMode | None = None
        for register, value in written:
            if register == MoteusRegister.MODE:
                mode, self._command = MoteusMode(int(value)), _COMMAND.copy()
            elif register in _COMMAND:
                self._command[register] = value
            elif register not in _UNLIMITED:
                moved = value - self.position_rad / TURN_RAD
                is_exact = register == MoteusRegister.SET_OUTPUT_EXACT
                self._zero_rad -= (moved if is_exact else round(moved)) * TURN_RAD
        if mode is None:
            return
        # A stop that asks for the state samples it, and another one is the command.
        self.targets += mode is not MoteusMode.STOPPED or not asks_reply
        self._fed_ns = now_ns
        if mode is MoteusMode.STOPPED:
            self._mode, self._fault, self._loop = mode, 0, None
        elif self._lasting_fault is not None:
            self._fail(self._lasting_fault, now_ns)
        elif self._mode not in (MoteusMode.FAULT, MoteusMode.TIMEOUT):
            self._mode, self._loop = mode, self._loop_for(mode)

    def _loop_for(self, mode: MoteusMode) -> Loop:
        """The loop of the present command."""
        command, gains = self._command, self._settings.gains
        damping = command[MoteusRegister.KD_SCALE] * gains.velocity_nm_s
        if mode is not MoteusMode.POSITION:
            return self._damper(damping)
        timeout_ms = self._settings.watchdog_ms or _DEFAULT_TIMEOUT_MS
        self._timeout_ns = command[MoteusRegister.WATCHDOG_TIMEOUT] * _S or timeout_ms * _MS
        position, velocity = (
            command[MoteusRegister.COMMAND_POSITION],
            command[MoteusRegister.COMMAND_VELOCITY],
        )
        most_nm, largest_nm = command[MoteusRegister.MAXIMUM_TORQUE], self._settings.max_torque_nm
        if not math.isnan(position):
            target_rad = position * TURN_RAD + self._zero_rad
        elif isinstance(self._loop, MovingLoop):
            target_rad = self._loop.loop.target_rad
        else:
            target_rad = self._reading.position_rad
        loop = JointLoop(
            target_rad, 0.0 if math.isnan(velocity) else velocity * TURN_RAD,
            command[MoteusRegister.KP_SCALE] * gains.position_1_s * gains.velocity_nm_s, damping,
            command[MoteusRegister.FEEDFORWARD_TORQUE], self._step_rad,
            largest_nm if math.isnan(most_nm) else min(most_nm, largest_nm),
        )  # fmt: skip
        return MovingLoop(loop, command[MoteusRegister.STOP_POSITION] * TURN_RAD + self._zero_rad)

    def _damper(self, damping_nm_s: float) -> JointLoop:
        """The loop of zero velocity."""
        return self._joint_loop((0.0, 0.0, 0.0, damping_nm_s, 0.0), self._settings.max_torque_nm)

    def _registers(self) -> dict[int, float]:
        """Registers that can be read."""
        reading, temperature_c = self._reading, self.temperature_c
        return self._command | {
            MoteusRegister.MODE: self._mode, MoteusRegister.POSITION: self.position_rad / TURN_RAD,
            MoteusRegister.VELOCITY: reading.velocity_rad_s / TURN_RAD,
            MoteusRegister.TORQUE: reading.torque_nm, MoteusRegister.D_CURRENT: 0.0,
            MoteusRegister.Q_CURRENT: reading.torque_nm / _TORQUE_CONSTANT_NM_A,
            MoteusRegister.MOTOR_TEMPERATURE: temperature_c, MoteusRegister.TRAJECTORY_COMPLETE: 1,
            MoteusRegister.VOLTAGE: _BUS_V, MoteusRegister.TEMPERATURE: temperature_c,
            MoteusRegister.FAULT: self._fault,
        }  # fmt: skip


def _may(register: int, value: float) -> bool:
    """Whether an emulated drive can do what a written register asks for."""
    if register == MoteusRegister.MODE:
        return value in (MoteusMode.STOPPED, MoteusMode.POSITION, MoteusMode.ZERO_VELOCITY)
    if register not in _WRITABLE or math.isinf(value):
        return False
    if math.isnan(value):
        return register not in _NEVER_NAN
    return register not in _NEVER_NEGATIVE | _UNLIMITED or (value < 0.0) == (register in _UNLIMITED)
