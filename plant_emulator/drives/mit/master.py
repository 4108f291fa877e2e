"""Master of drives with the MIT protocol."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence

from bus_schema.arrays import Vector
from bus_schema.can.frame import CanBus, CanFrame
from bus_schema.can.master import DriveError
from bus_schema.can.position.aiming import AimingMaster
from bus_schema.link.can_configuration import CanConfiguration
from plant_emulator.drives.mit.codec import MitCodec
from plant_emulator.drives.mit.wire import Special

_POLL_S = 0.05
_AGAIN_S = 0.3
_QUIET_S, _LONGEST_QUIET_S = 0.1, 1.0


class Replies:
    """A bus that keeps replies to commands back: only those to requests are states.

    Nothing in a reply says which frame it answers, but a drive answers in turn. See `CanBus`.

    Attributes:
        owed: commands to each joint's drive that it has not replied to yet.
        errors: error byte of each joint's last reply.
    """

    def __init__(self, bus: CanBus, codec: MitCodec, joints: int) -> None:
        self._bus, self._codec = bus, codec
        self.owed = [0] * joints
        self.errors = [0] * joints

    def send(self, frame: CanFrame) -> None:
        self._bus.send(frame)

    def send_all(self, frames: Sequence[CanFrame]) -> None:
        self._bus.send_all(frames)

    def receive(self, timeout_s: float) -> CanFrame | None:
        give_up_s = time.monotonic() + timeout_s
        while True:
            frame = self._bus.receive(max(0.0, give_up_s - time.monotonic()))
            if frame is None or not self._is_owed(frame):
                return frame

    def settle(self) -> None:
        """Drop what has come, and wait for no reply to a command that was sent before."""
        while self.receive(0.0) is not None:
            pass
        self.owed = [0] * len(self.owed)

    def dropped(self) -> int | None:
        return self._bus.dropped()

    def close(self) -> None:
        self._bus.close()

    def _is_owed(self, frame: CanFrame) -> bool:
        found = self._codec.reply(frame)
        if found is None:
            return False
        joint, reply = found
        self.errors[joint] = reply.error
        is_owed = self.owed[joint] > 0
        self.owed[joint] -= is_owed
        return is_owed


class MitMaster(AimingMaster):
    """The master; the arguments are those of `CanMaster`.

    Drives are found by leaving motor mode, which also takes what a former master said out of force;
    the first request for states enters it, the first command moves a joint.
    """

    _codec: MitCodec

    def __init__(
        self, bus: CanBus, can: CanConfiguration, node_ids: tuple[int, ...], codec: MitCodec
    ) -> None:
        self._replies = Replies(bus, codec, len(node_ids))
        super().__init__(self._replies, can, node_ids, codec)
        self._is_leaving = False

    def enable(self, timeout_s: float, is_stop_requested: Callable[[], bool]) -> bool:
        give_up_s = time.monotonic() + timeout_s
        missing = set(self._joint_of.values())
        while missing:
            self._send(self._codec.special_frames(Special.EXIT)[joint] for joint in sorted(missing))
            missing = self._unanswered(missing, is_stop_requested)
            if is_stop_requested():
                return False
            if missing and time.monotonic() > give_up_s:
                nodes = ", ".join(str(self._node_ids[joint]) for joint in sorted(missing))
                raise DriveError(f"no answer from drive {nodes} within {timeout_s:g} s")
        self._await_quiet()
        if errors := self._missed_heartbeats():
            raise DriveError("; ".join(errors))
        self._is_powered = [True] * len(self._node_ids)
        return True

    def _only_master_sends(self, frame: CanFrame) -> str | None:
        is_command = frame.identifier in self._joint_of and not frame.is_remote
        return "commands" if is_command and self._codec.reply(frame) is None else None

    def sample(self, now_ns: int) -> None:
        if self._awaited:  # a reply was lost, and those that come would be taken for one another
            self._replies.settle()
        if not self._is_stopping:
            super().sample(now_ns)
            return
        self._now_ns, self._is_leaving = now_ns, True
        self._awaited = set(self._joint_of.values()) - self._silent
        self._send(self._codec.special_frames(Special.EXIT))

    def read(self, timeout_s: float, position: Vector, velocity: Vector) -> bool:
        is_complete = super().read(timeout_s, position, velocity)
        if self._is_leaving:
            for joint in set(self._joint_of.values()) - self._awaited:
                self._is_powered[joint] = False
        return is_complete

    def command(self, torque_nm: Vector) -> None:
        self._replies.owed = [owed + 1 for owed in self._replies.owed]
        super().command(torque_nm)

    def leave(self) -> None:
        self._send(self._codec.special_frames(Special.EXIT))

    def _unanswered(self, missing: set[int], is_stop_requested: Callable[[], bool]) -> set[int]:
        """Which of some drives do not reply for a while."""
        missing, until_s = set(missing), time.monotonic() + _AGAIN_S
        while missing and time.monotonic() < until_s and not is_stop_requested():
            frame = self._bus.receive(_POLL_S)
            found = None if frame is None else self._codec.reply(frame)
            if found is not None:
                missing.discard(found[0])
        return missing

    def _await_quiet(self) -> None:
        """Let all replies come to what had to be said more than once."""
        began_s = quiet_since_s = time.monotonic()
        while time.monotonic() < min(quiet_since_s + _QUIET_S, began_s + _LONGEST_QUIET_S):
            frame = self._bus.receive(_POLL_S)
            if frame is not None and self._codec.reply(frame) is not None:
                quiet_since_s = time.monotonic()

    def _missed_heartbeats(self) -> list[str]:
        """Errors that replies report; there are no heartbeats."""
        return [
            f"drive {node_id}: error {error}"
            for node_id, error in zip(self._node_ids, self._replies.errors, strict=True)
            if error
        ]

    def _send_heartbeat(self) -> None:
        """There are none."""

    def _handle_report(self, frame: CanFrame) -> None:
        """There are none."""
