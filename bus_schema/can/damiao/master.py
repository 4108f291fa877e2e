"""Master of Damiao motors."""

from __future__ import annotations

import time
from collections.abc import Callable

from bus_schema.can.damiao.codec import DamiaoCodec, Mode, Special, Status
from bus_schema.can.damiao.registers import (
    RANGES,
    REGISTER_IDENTIFIER,
    TIMEOUT_STEP_NS,
    Register,
    RegisterFrame,
    Request,
    register_frame,
)
from bus_schema.can.frame import CanFrame
from bus_schema.can.master import POLL_S, DriveError
from bus_schema.can.mit.master import MitMaster

_MS = 1_000_000


class DamiaoMaster(MitMaster):
    """The master; the arguments are those of `CanMaster`.

    Motors are found by disabling them. Before they are enabled, their ranges are read: of a motor
    with others than the scenario's, every number would be wrong. Then they get MIT mode and the
    scenario's timeout. Nothing is stored.
    """

    _codec: DamiaoCodec

    def enable(self, timeout_s: float, is_stop_requested: Callable[[], bool]) -> bool:
        if not self._await_drives(timeout_s, is_stop_requested):
            return False
        self._await_quiet()
        for joint in range(len(self._node_ids)):
            self._check_ranges(joint)
            self._write(joint, Register.CTRL_MODE, Mode.MIT)
            timeout_ns = self._can.command_timeout_ms * _MS
            self._write(joint, Register.TIMEOUT, timeout_ns // TIMEOUT_STEP_NS)
            self._tell(joint, Special.CLEAR_ERROR)
            self._tell(joint, Special.ENABLE)
        if errors := self._missed_heartbeats():
            raise DriveError("; ".join(errors))
        self._is_powered = [True] * len(self._node_ids)
        return True

    def _only_master_sends(self, frame: CanFrame) -> str | None:
        if frame.identifier == REGISTER_IDENTIFIER:
            return "requests"
        nodes = [frame.identifier - mode.offset for mode in Mode]
        return "commands" if any(node in self._joint_of for node in nodes) else None

    def _missed_heartbeats(self) -> list[str]:
        """One sentence for each motor that is not enabled."""
        return [
            f"drive {node_id}: {_in_words(status)}"
            for node_id, status in zip(self._node_ids, self._errors, strict=True)
            if status != Status.ENABLED
        ]

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

    def _tell(self, joint: int, kind: Special) -> None:
        """Send a special frame, and note the state in the answer."""
        self._send([self._codec.special_frames(kind)[joint]])
        give_up_s = time.monotonic() + self._can.answer_timeout_s
        while self._next_answering(POLL_S) != joint:
            if time.monotonic() > give_up_s:
                raise DriveError(self._silence(joint, kind.name))

    def _write(self, joint: int, register: Register, value: int) -> None:
        written = self._ask_register(joint, Request.WRITE, register, value)
        if written != value:
            raise DriveError(
                f"drive {self._node_ids[joint]} has {written:g} instead of {value} in"
                f" {register.name}"
            )

    def _ask_register(
        self, joint: int, request: Request, register: Register, value: float = 0.0
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
