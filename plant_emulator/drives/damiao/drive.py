"""A Damiao motor: special frames, commands of four modes, registers, feedback, errors, timeout.

States and errors are those of the manual of the DM-J8009P-2EC, V1.0: the error of a feedback frame
is 1 in the enabled state and 0 in the disabled one, and every fault leaves the enabled state. Error
5 is that of the manual of the DM-S3519-1EC, V1.1.
"""

from __future__ import annotations

from bus_schema.can.damiao.codec import (
    REGISTER_IDENTIFIER,
    TIMEOUT_STEP_NS,
    DamiaoMode,
    DamiaoRegister,
    RegisterFrame,
    Request,
    Status,
    Target,
    feedback_of,
    packed_feedback,
    register_frame,
    target_of,
)
from bus_schema.can.damiao.protocol import DamiaoSettings
from bus_schema.can.frame import CanFrame
from bus_schema.can.mit.codec import (
    COMMAND_BYTES,
    MitCommand,
    MitRanges,
    Special,
    command_of,
    ending_of,
    special_of,
)
from bus_schema.errors import InvalidMessageError
from plant_emulator.drives.cascade import CascadeGains, CascadeLoop, Integral
from plant_emulator.drives.damiao.registers import Registers
from plant_emulator.drives.drive import DriveFault, DriveSettings, JointLoop, Send
from plant_emulator.drives.loop_drive import LoopDrive

_ERRORS = {
    None: Status.DISABLED,
    DriveFault.DRIVE: Status.OVER_CURRENT,
    DriveFault.OVER_TEMPERATURE: Status.COIL_HOT,
    DriveFault.ENCODER: Status.SENSOR_ERROR,
}
_RESTARTING = {DamiaoRegister.CTRL_MODE, DamiaoRegister.ESC_ID, DamiaoRegister.MST_ID}


class DamiaoDrive(LoopDrive[DamiaoSettings]):
    """One motor, see `Drive`; position and torque are the joint's."""

    def __init__(self, settings: DriveSettings[DamiaoSettings], send: Send) -> None:
        super().__init__(settings, send)
        motor = settings.own.motor
        self._registers = Registers(settings)
        ranges = motor.ranges
        self._gain_ranges = ranges.stiffness_nm_rad, ranges.damping_nm_s
        self._note_registers()
        self._peak_nm = min(settings.max_torque_nm, motor.peak_nm)
        self._error = Status.DISABLED
        self._integral = Integral()

    @property
    def status(self) -> str:
        return f"{self._error.name} ({self._mode.name})"

    @property
    def fault(self) -> str | None:
        if self._error in (Status.DISABLED, Status.ENABLED):
            return None
        return f"{self._error.name} (error {self._error:#x})"

    def receive(self, frame: CanFrame, now_ns: int) -> bool:
        if self._is_off_bus:
            return False
        mode = self._modes.get(frame.identifier)
        is_request = frame.identifier == REGISTER_IDENTIFIER
        if mode is None and not (is_request and self._is_meant(frame.data)):
            return False
        if frame.is_remote:
            raise InvalidMessageError("no_command", f"motors answer no remote frame: {frame}")
        if mode is None:
            self._serve(register_frame(frame.data))
        else:
            self._obey(mode, frame.data)
            self._report()
        self._fed_ns = now_ns
        return True

    @property
    def timeout_ns(self) -> float:
        return self._registers[DamiaoRegister.TIMEOUT] * TIMEOUT_STEP_NS

    def _time_out(self) -> None:
        self._rest(Status.LOST_COMMUNICATION)

    def _fail(self, fault: DriveFault, now_ns: int) -> None:  # noqa: ARG002 (the interface)
        self._rest(_ERRORS[fault])

    def describe(self, frame: CanFrame) -> str | None:
        mode, is_whole = self._modes.get(frame.identifier), len(frame.data) == COMMAND_BYTES
        name = f"drive {self._node_id}"
        if frame.identifier == REGISTER_IDENTIFIER and self._is_meant(frame.data):
            return f"{name} asked: {_asked(register_frame(frame.data))}"
        if frame.identifier == self._registers[DamiaoRegister.MST_ID] and is_whole:
            return f"{name} state: {feedback_of(frame.data, self._ranges)}"
        if mode is None:
            return None
        if is_whole and ending_of(frame.data) is not None:
            kind = special_of(frame.data)
            return f"{name} " + ("no command" if kind is None else kind.name.lower())
        return f"{name} {mode.name}: {self._commanded(mode, frame.data) or 'no command'}"

    @property
    def _mode(self) -> DamiaoMode:
        return DamiaoMode(int(self._registers[DamiaoRegister.CTRL_MODE]))

    def _note_registers(self) -> None:
        """Cache the register values that every frame needs."""
        values = self._registers
        limits = (
            values[DamiaoRegister.PMAX],
            values[DamiaoRegister.VMAX],
            values[DamiaoRegister.TMAX],
        )
        self._ranges = MitRanges(*limits, *self._gain_ranges)
        self._node_id = int(values[DamiaoRegister.ESC_ID])
        self._modes = {self._node_id + mode.offset: mode for mode in DamiaoMode}
        self.identifiers = {REGISTER_IDENTIFIER, *self._modes}
        self.on_set_up()

    def _is_meant(self, data: bytes) -> bool:
        return len(data) == COMMAND_BYTES and data[0] | data[1] << 8 == self._node_id

    def _obey(self, mode: DamiaoMode, data: bytes) -> None:
        """Receive a special frame, or a command of the active mode."""
        if len(data) == COMMAND_BYTES and ending_of(data) is not None:
            self._change(special_of(data), data)
            return
        command = self._commanded(mode, data)
        if command is None:
            raise InvalidMessageError("no_command", f"{data.hex()} is no {mode.name} command")
        if mode is not self._mode:
            text = f"a {mode.name} command, and CTRL_MODE is {self._mode.name}"
            raise InvalidMessageError("wrong_mode", text)
        self.targets += 1
        if self._error is Status.ENABLED:  # it stays in force until the next one
            self._loop = self._loop_for(command)

    def _commanded(self, mode: DamiaoMode, data: bytes) -> MitCommand | Target | None:
        if mode is not DamiaoMode.MIT:
            return target_of(mode, data)
        is_command = len(data) == COMMAND_BYTES and ending_of(data) is None
        return command_of(data, self._ranges) if is_command else None

    def _change(self, kind: Special | None, data: bytes) -> None:
        """Enable, disable, clear the error, or make the position zero."""
        if kind is None:
            raise InvalidMessageError("no_command", f"there is no special frame {data.hex()}")
        is_enabled = self._error is Status.ENABLED
        if kind is Special.ZERO:
            self._make_zero()
        elif kind is Special.ENABLE and self._error is Status.DISABLED:
            self._error = Status.ENABLED
        elif kind is Special.DISABLE and is_enabled:
            self._rest(Status.DISABLED)
        elif kind is Special.CLEAR_ERROR and not is_enabled:
            self._error = _ERRORS[self._lasting_fault]

    def _loop_for(self, command: MitCommand | Target) -> JointLoop | CascadeLoop:
        values, is_velocity = self._registers, self._mode is DamiaoMode.VEL
        most_nm = min(self._peak_nm, values[DamiaoRegister.TMAX])
        if isinstance(command, MitCommand):
            return self._joint_loop(command, most_nm)
        gains = CascadeGains(
            0.0 if is_velocity else values[DamiaoRegister.KP_APR],
            values[DamiaoRegister.KP_ASR], values[DamiaoRegister.KI_ASR],
        )  # fmt: skip
        fastest = values[DamiaoRegister.MAX_SPD]
        wanted = command.velocity_rad_s if is_velocity else 0.0
        most_rad_s = fastest if is_velocity else min(abs(command.velocity_rad_s), fastest)
        return CascadeLoop(
            command.position_rad + self._zero_rad, wanted, 0.0, gains, self._step_rad,
            most_rad_s, command.torque_share * most_nm, self._integral,
        )  # fmt: skip

    def _rest(self, error: Status) -> None:
        self._error, self._loop, self._integral = error, None, Integral()

    def _serve(self, asked: RegisterFrame) -> None:
        """Answer a request for the state or a register."""
        self._registers.show(self.position_rad)
        if asked.request == Request.REFRESH:
            self.samplings += 1
            self._report()
            return
        answer = asked
        if asked.request == Request.READ:
            answer = asked._replace(value=self._registers[asked.register])
        elif asked.request == Request.WRITE:
            self._write(asked.register, asked.value)
        elif asked.request == Request.STORE and self._error is not Status.ENABLED:
            answer = RegisterFrame(asked.node_id, Request.STORE, 1)
        else:
            raise InvalidMessageError("no_request", f"the motor does nothing about {asked}")
        self._answer(answer.packed())

    def _write(self, register: int, value: float) -> None:
        """Set a register; it acts at once, and a new mode needs a new command."""
        self._registers.write(register, value)
        self._note_registers()
        if register in _RESTARTING:
            self._loop, self._integral = None, Integral()

    def _report(self) -> None:
        state = self._state(self._error)._replace(node_id=self._node_id)
        self._answer(packed_feedback(state, self._ranges, self.temperature_c))

    def _answer(self, data: bytes) -> None:
        identifier = int(self._registers[DamiaoRegister.MST_ID])
        self._transmit(CanFrame(identifier, data, is_fd=self._settings.fd_process_data))


def _asked(asked: RegisterFrame) -> str:
    requests = [each.name.lower() for each in Request if each == asked.request]
    return f"{requests[0] if requests else hex(asked.request)} {asked.register} {asked.value:.6g}"
