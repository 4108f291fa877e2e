"""Damiao motors: their settings in a scenario, and their master."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from typing import NamedTuple

from bus_schema.can.damiao.codec import (
    RANGES,
    REGISTER_IDENTIFIER,
    TIMEOUT_STEP_NS,
    DamiaoCodec,
    DamiaoMode,
    DamiaoRegister,
    RegisterFrame,
    Request,
    Status,
    register_frame,
)
from bus_schema.can.damiao.motors import MOTORS, DamiaoMotor
from bus_schema.can.frame import CanFrame, is_data
from bus_schema.can.master import POLL_S, DriveError
from bus_schema.can.mit.codec import COMMAND_BYTES, MitRanges, Special
from bus_schema.can.mit.protocol import MitMaster, MitProtocol
from bus_schema.configuration import ConfigurationError
from bus_schema.drive_feedback import DriveGains
from bus_schema.link.can_configuration import CanConfiguration, DamiaoMotorName
from bus_schema.robot_description import RobotDescription

_MS = 1_000_000


class DamiaoMaster(MitMaster):
    """The master; the arguments are those of `CanMaster`.

    Motors are found by disabling them. Before they are enabled, their ranges are read: of a motor
    with others than the scenario's, every number would be wrong. Then they get MIT mode and the
    scenario's timeout. Nothing is stored.
    """

    _codec: DamiaoCodec

    def _set_up_drive(self, joint: int) -> None:
        self._check_ranges(joint)
        self._write(joint, DamiaoRegister.CTRL_MODE, DamiaoMode.MIT)
        timeout_ns = self._can.command_timeout_ms * _MS
        self._write(joint, DamiaoRegister.TIMEOUT, timeout_ns // TIMEOUT_STEP_NS)
        self._switch(joint, Special.CLEAR_ERROR)
        self._switch(joint, Special.ENABLE)

    def _only_master_sends(self, frame: CanFrame) -> str | None:
        if frame.identifier == REGISTER_IDENTIFIER:
            return "requests"
        nodes = [frame.identifier - mode.offset for mode in DamiaoMode]
        return "commands" if any(node in self._joint_of for node in nodes) else None

    def _missed_heartbeats(self) -> list[str]:
        """One sentence for each motor that is not enabled."""
        return [
            f"drive {node_id}: {_in_words(status)}"
            for node_id, status in zip(self._node_ids, self._errors, strict=True)
            if status != Status.ENABLED
        ]

    def _who_is_absent(self, timeout_s: float) -> str:
        sent = "CAN FD" if self._can.fd_process_data else "classical"
        return f"{super()._who_is_absent(timeout_s)} to {sent} frames (link.can.fd_process_data)"

    def _check_ranges(self, joint: int) -> None:
        for register, name in RANGES.items():
            expected = getattr(self._codec.ranges[joint], name)
            found = self._ask_register(joint, Request.READ, register)
            if abs(found - expected) > 1e-3 * expected:
                raise DriveError(
                    f"drive {self._node_ids[joint]}: {register.name} is {found:g}, and with"
                    f" link.can.damiao.motor it is {expected:g}: values in its frames would be"
                    " misread"
                )

    def _switch(self, joint: int, kind: Special) -> None:
        """Send a special frame, and store the error code in the answer."""
        self._send([self._codec.special_frames(kind)[joint]])
        give_up_s = time.monotonic() + self._can.answer_timeout_s
        while self._next_answering(POLL_S) != joint:
            if time.monotonic() > give_up_s:
                raise DriveError(self._silence(joint, kind.name))

    def _write(self, joint: int, register: DamiaoRegister, value: int) -> None:
        written = self._ask_register(joint, Request.WRITE, register, value)
        if written != value:
            raise DriveError(
                f"drive {self._node_ids[joint]} has {written:g} instead of {value} in"
                f" {register.name}"
            )

    def _ask_register(
        self, joint: int, request: Request, register: DamiaoRegister, value: float = 0.0
    ) -> float:
        """Value in a motor's answer.

        Raises:
            DriveError: it does not answer.
        """
        asked = RegisterFrame(self._node_ids[joint], request, register, value)
        self._send([self._codec.frame(REGISTER_IDENTIFIER, asked.packed())])
        give_up_s = time.monotonic() + self._can.answer_timeout_s
        while time.monotonic() < give_up_s:
            frame = self._bus.receive(POLL_S)
            found = None if frame is None else self._codec.reply(frame)
            if frame is not None and found is not None and found[0] == joint:
                answer = register_frame(frame.data)
                if answer[:3] == asked[:3]:
                    return answer.value
        raise DriveError(self._silence(joint, f"{request.name} {register.name}"))

    def _silence(self, joint: int, what: str) -> str:
        timeout_s = self._can.answer_timeout_s
        return f"drive {self._node_ids[joint]}: no answer to {what} within {timeout_s:g} s"


def _in_words(status: int) -> str:
    known = [each.name.lower().replace("_", " ") for each in Status if each == status]
    return known[0] if known else f"error {status:#x}"


_FEEDBACK_OFFSET = 0x10


class DamiaoSettings(NamedTuple):
    """Settings of one motor that both sides must share.

    Attributes:
        motor: its kind.
        feedback_id: identifier of its frames.
    """

    motor: DamiaoMotor = MOTORS["DM4310"]
    feedback_id: int = _FEEDBACK_OFFSET + 1


class DamiaoProtocol(MitProtocol):
    """MIT mode, three others, registers, and feedback at an identifier of each motor's own."""

    title = "Damiao"
    has_fd_process_data = True
    range_key = "{name} of link.can.damiao.motor"
    master = DamiaoMaster

    def codec(
        self, can: CanConfiguration, robot: RobotDescription, gains: DriveGains | None = None
    ) -> DamiaoCodec:
        ranges = self.ranges(can, robot.joints)
        self._check_gains(gains, ranges)
        node_ids, feedback_ids = self.node_ids(can, robot.joints), _feedback_ids(can, robot.joints)
        is_fd = can.fd_process_data
        return DamiaoCodec(node_ids, ranges, feedback_ids, is_fd=is_fd, gains=gains)

    def ranges(self, can: CanConfiguration, joints: int) -> tuple[MitRanges, ...]:
        return tuple(MOTORS[name].ranges for name in _motors(can, joints))

    def node_ids(self, can: CanConfiguration, joints: int) -> tuple[int, ...]:
        node_ids = can.node_ids_of(joints)
        taken = {node_id + mode.offset for node_id in node_ids for mode in DamiaoMode}
        feedback_ids = _feedback_ids(can, joints)
        if twice := sorted({*taken, REGISTER_IDENTIFIER} & {*feedback_ids}):
            raise ConfigurationError(
                "link.can.damiao.feedback_ids", list(feedback_ids),
                "must differ from the identifiers of commands (the addresses, those plus"
                f" 0x100, 0x200 and 0x300, and 0x7FF); {twice} do not", ["link.can.node_ids"],
            )  # fmt: skip
        return node_ids

    def questions(self, can: CanConfiguration, node_id: int) -> Sequence[CanFrame]:
        asked = (RegisterFrame(node_id, Request.READ, register).packed() for register in RANGES)
        return [CanFrame(REGISTER_IDENTIFIER, each, is_fd=can.fd_process_data) for each in asked]

    def answer(self, frame: CanFrame) -> tuple[int, str, float] | None:
        if not is_data(frame, COMMAND_BYTES, is_fd=frame.is_fd):
            return None
        node_id, request, register, value = register_frame(frame.data)
        is_ours = frame.identifier != REGISTER_IDENTIFIER and request == Request.READ
        return (
            (node_id, DamiaoRegister(register).name, value)
            if is_ours and register in RANGES
            else None
        )

    def expected_answers(
        self, can: CanConfiguration, robot: RobotDescription
    ) -> Sequence[Mapping[str, float]]:
        return [
            {register.name: getattr(ranges, name) for register, name in RANGES.items()}
            for ranges in self.ranges(can, robot.joints)
        ]

    def own_settings(
        self, can: CanConfiguration, robot: RobotDescription
    ) -> tuple[DamiaoSettings, ...]:
        motors = [MOTORS[name] for name in _motors(can, robot.joints)]
        return tuple(map(DamiaoSettings, motors, _feedback_ids(can, robot.joints)))


def _motors(can: CanConfiguration, joints: int) -> tuple[DamiaoMotorName, ...]:
    names = can.damiao.motor
    if len(names) not in (1, joints):
        raise ConfigurationError(
            "link.can.damiao.motor", list(names), f"one, or one for each of the {joints} joints"
        )
    return names * joints if len(names) == 1 else names


def _feedback_ids(can: CanConfiguration, joints: int) -> tuple[int, ...]:
    given = can.damiao.feedback_ids
    feedback_ids = given or tuple(_FEEDBACK_OFFSET + each for each in can.node_ids_of(joints))
    if len(feedback_ids) != joints:
        raise ConfigurationError(
            "link.can.damiao.feedback_ids",
            list(feedback_ids),
            f"one for each of the {joints} joints",
        )
    return feedback_ids
