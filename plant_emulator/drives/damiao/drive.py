"""A Damiao motor on its bus: commands of four modes, special frames, registers, feedback."""

from __future__ import annotations

from bus_schema.can.damiao.codec import (
    Mode,
    Special,
    Target,
    feedback_of,
    packed_feedback,
    target_of,
)
from bus_schema.can.damiao.registers import (
    REGISTER_IDENTIFIER,
    Register,
    RegisterFrame,
    Request,
    register_frame,
)
from bus_schema.can.frame import CanFrame
from bus_schema.can.mit.codec import COMMAND_BYTES, MitCommand, MitReply, command_of, ending_of
from bus_schema.errors import InvalidMessageError
from plant_emulator.drives.damiao.motor import DamiaoAxis

_MODES = {mode.offset: mode for mode in Mode}


class DamiaoDrive(DamiaoAxis):
    """One motor, see `Drive`; position and torque are the joint's."""

    targets = samplings = 0

    def receive(self, frame: CanFrame, now_ns: int) -> bool:
        if self._is_off_bus:
            return False
        mode = self._mode_at(frame.identifier)
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
        self._heard_ns = now_ns
        return True

    def describe(self, frame: CanFrame) -> str | None:
        node_id, mode = self._node_id, self._mode_at(frame.identifier)
        is_whole = len(frame.data) == COMMAND_BYTES
        if frame.identifier == REGISTER_IDENTIFIER and self._is_meant(frame.data):
            return f"drive {node_id} asked: {_asked(register_frame(frame.data))}"
        if frame.identifier == self._registers[Register.MST_ID] and is_whole:
            return f"drive {node_id} state: {feedback_of(frame.data, self._ranges)}"
        if mode is None:
            return None
        ending = ending_of(frame.data) if is_whole else None
        names = [each.name.lower() for each in Special if each == ending]
        if names or ending is not None:
            return f"drive {node_id} " + (names[0] if names else "no command")
        return f"drive {node_id} {mode.name}: {self._commanded(mode, frame.data) or 'no command'}"

    def _mode_at(self, identifier: int) -> Mode | None:
        return _MODES.get(identifier - self._node_id)

    def _is_meant(self, data: bytes) -> bool:
        return len(data) == COMMAND_BYTES and data[0] | data[1] << 8 == self._node_id

    def _obey(self, mode: Mode, data: bytes) -> None:
        """Take a special frame, in every mode, or a command of the mode that is set."""
        ending = ending_of(data) if len(data) == COMMAND_BYTES else None
        if ending is not None:
            kind = next((each for each in Special if each == ending), None)
            if kind is None:
                raise InvalidMessageError("no_command", f"there is no special frame {data.hex()}")
            self.change(kind)
            return
        command = self._commanded(mode, data)
        if command is None:
            raise InvalidMessageError("no_command", f"{data.hex()} is no {mode.name} command")
        if mode is not self.mode:
            text = f"a {mode.name} command, and CTRL_MODE is {self.mode.name}"
            raise InvalidMessageError("wrong_mode", text)
        self.targets += 1
        self.take(command)

    def _commanded(self, mode: Mode, data: bytes) -> MitCommand | Target | None:
        if mode is not Mode.MIT:
            return target_of(mode, data)
        is_command = len(data) == COMMAND_BYTES and ending_of(data) is None
        return command_of(data, self._ranges) if is_command else None

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
            self.write(asked.register, asked.value)
        elif asked.request == Request.STORE and not self.is_enabled:
            answer = RegisterFrame(asked.node_id, Request.STORE, 1)
        else:
            raise InvalidMessageError("no_request", f"the motor does nothing about {asked}")
        self._answer(answer.packed())

    def _report(self) -> None:
        reading, hot_c = self._reading, self.temperature_c
        state = MitReply(
            self._node_id, self.position_rad, reading.velocity_rad_s, reading.torque_nm,
            hot_c, self.error,
        )  # fmt: skip
        self._answer(packed_feedback(state, self._ranges, hot_c))

    def _answer(self, data: bytes) -> None:
        identifier = int(self._registers[Register.MST_ID])
        self._transmit(CanFrame(identifier, data, is_fd=self._settings.fd_process_data))


def _asked(asked: RegisterFrame) -> str:
    requests = [each.name.lower() for each in Request if each == asked.request]
    return f"{requests[0] if requests else hex(asked.request)} {asked.register} {asked.value:.6g}"
