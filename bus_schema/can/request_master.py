"""The master of drives that answer each request with their state."""

from __future__ import annotations

import time
from abc import abstractmethod
from collections.abc import Sequence

from bus_schema.arrays import Vector
from bus_schema.can.codec import CanCodec
from bus_schema.can.frame import CanBus, CanFrame
from bus_schema.can.master import POLL_S, CanMaster, DriveError
from bus_schema.link.can_configuration import CanConfiguration

_QUIET_S, _LONGEST_QUIET_S = 0.1, 1.0


class RequestMaster(CanMaster):
    """The master; the arguments are those of `CanMaster`.

    It finds drives by requests to stop. An answer does not say which frame it answers, but a drive
    answers in order: the master counts the commands that each drive has yet to answer. Only answers
    to requests count as states.
    """

    def __init__(
        self, bus: CanBus, can: CanConfiguration, node_ids: tuple[int, ...], codec: CanCodec
    ) -> None:
        super().__init__(bus, can, node_ids, codec)
        self._owed = [0] * len(node_ids)
        self._errors = [0] * len(node_ids)
        self._is_leaving = False

    @abstractmethod
    def _stop_requests(self) -> Sequence[CanFrame]:
        """Return a frame for each drive, which stops it and which it answers with its state."""

    def _set_up(self) -> None:
        self._await_quiet()
        for joint in range(len(self._node_ids)):
            self._set_up_drive(joint)
        if errors := self._missed_heartbeats():
            raise DriveError("; ".join(errors))

    def _set_up_drive(self, joint: int) -> None:
        """Check and configure a drive that has answered."""

    def _only_master_sends(self, frame: CanFrame) -> str | None:
        is_command = frame.identifier in self._joint_of and not frame.is_remote
        return "commands" if is_command and self._codec.reply(frame) is None else None

    def sample(self, now_ns: int) -> None:
        if self._awaited:  # an answer was lost: later ones must not be mistaken for it
            self._settle()
        if not self._is_stopping:
            super().sample(now_ns)
            return
        self._now_ns, self._is_leaving = now_ns, True
        self._awaited = set(self._joint_of.values()) - self._silent
        self._send(self._stop_requests())

    def read(self, timeout_s: float, position: Vector, velocity: Vector) -> bool:
        is_complete = super().read(timeout_s, position, velocity)
        if self._is_leaving:
            for joint in set(self._joint_of.values()) - self._awaited:
                self._is_powered[joint] = False
        return is_complete

    def command(self, torque_nm: Vector) -> None:
        self._owed = [owed + 1 for owed in self._owed]
        super().command(torque_nm)

    def leave(self) -> None:
        self._send(self._stop_requests())

    def _ask(self) -> None:
        frames = self._stop_requests()
        self._send(frames[joint] for joint in sorted(self._absent))

    def _listen(self) -> None:
        self._absent -= {self._next_answering(POLL_S)}

    def _await_quiet(self) -> None:
        """Receive the answers to all repeated requests."""
        began_s = quiet_since_s = time.monotonic()
        while time.monotonic() < min(quiet_since_s + _QUIET_S, began_s + _LONGEST_QUIET_S):
            if self._next_answering(POLL_S) is not None:
                quiet_since_s = time.monotonic()

    def _next_answering(self, timeout_s: float) -> int | None:
        """Return the joint whose drive sent the next frame; None if it is no answer."""
        frame = self._bus.receive(timeout_s)
        return None if frame is None else self._note_answer(frame)

    def _note_answer(self, frame: CanFrame) -> int | None:
        """Process a frame outside the loop; return the joint that it answers for, or None."""
        joint = self._note_reply(frame)
        if joint is None:
            self._note_stranger(frame)
        return joint

    def _note_reply(self, frame: CanFrame) -> int | None:
        """Store the error code in an answer; return its joint, or None for any other frame."""
        found = self._codec.reply(frame)
        if found is None:
            return None
        joint, state = found
        self._errors[joint] = state.error
        return joint

    def _take_in(self, frame: CanFrame, position: Vector, velocity: Vector) -> int | None:
        joint = self._note_reply(frame)
        if joint is not None and self._owed[joint]:
            self._owed[joint] -= 1
            return None
        return super()._take_in(frame, position, velocity)

    def _settle(self) -> None:
        """Discard pending frames, and expect no more answers to earlier commands."""
        while (frame := self._bus.receive(0.0)) is not None:
            self._note_answer(frame)
        self._owed = [0] * len(self._owed)

    def _missed_heartbeats(self) -> list[str]:
        """Return the errors in the answers; these drives have no heartbeats."""
        return [
            f"drive {node_id}: error {error}"
            for node_id, error in zip(self._node_ids, self._errors, strict=True)
            if error
        ]
