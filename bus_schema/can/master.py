"""The master of a CAN bus with motor drives: what all protocols have in common."""

from __future__ import annotations

import time
from abc import ABC, abstractmethod
from collections import Counter
from collections.abc import Callable, Iterable

import numpy as np

from bus_schema.arrays import Matrix, Vector
from bus_schema.can.codec import CanCodec
from bus_schema.can.frame import BUS_OFF, CanBus, CanFrame
from bus_schema.errors import BusError
from bus_schema.link.can_configuration import CanConfiguration

_MOST_LATE = 100
_NEARLY = 0.8
POLL_S = 0.05
"""Time for which a master that enables drives waits for a frame."""


class DriveError(BusError):
    """A drive is not the expected one, or has failed; the message names it."""


class SilentDriveError(DriveError):
    """A drive sends no states while others do; without its states, no drive gets a torque."""

    is_cause = True


class CanMaster(ABC):
    """The master of one protocol; joints are counted from 0.

    Args:
        bus: where the drives are.
        can: section ``link.can`` of the scenario.
        node_ids: addresses of the drives, one for each joint.
        codec: the frames of a cycle.

    Attributes:
        ask_again_s: time to answer before a request is repeated.
        emergencies: first error that each drive reported, in a sentence. If it stops the drive,
            `read` raises `DriveError`.
    """

    ask_again_s = 0.3

    def __init__(
        self, bus: CanBus, can: CanConfiguration, node_ids: tuple[int, ...], codec: CanCodec
    ) -> None:
        self._bus, self._can, self._codec = bus, can, codec
        self._node_ids = node_ids
        self._joint_of = {node_id: joint for joint, node_id in enumerate(node_ids)}
        # Joints whose drives have not answered the last sampling, and joints whose drives are no
        # longer awaited.
        self._awaited: set[int] = set()
        self._silent: set[int] = set()
        self._absent: set[int] = set()  # joints whose drives have not answered yet
        self._is_powered = [False] * len(node_ids)
        self._faults: list[str] = []
        self.emergencies: list[str] = []
        self._is_stopping = False
        self._target: Matrix | None = None
        self._strangers: Counter[str] = Counter()
        self._other_format: Counter[str] = Counter()
        self._samplings, self._answers = 0, [0] * len(node_ids)
        self._skipped = np.zeros((2, len(node_ids)))
        self._now_ns = 0
        self._last_answer_ns = [0] * len(node_ids)
        self._next_heartbeat_ns = 0

    def enable(self, timeout_s: float, is_stop_requested: Callable[[], bool]) -> bool:
        """Take all drives from power-on to following torques; return false if asked to stop.

        Args:
            timeout_s: longest wait for the drives to answer, wall time.
            is_stop_requested: checked while waiting.

        Raises:
            DriveError: a drive does not answer, is not the expected one, or does not follow.
            BusError: the bus itself was lost.
        """
        if not self._await_drives(timeout_s, is_stop_requested):
            return False
        self._set_up()
        self._is_powered = [True] * len(self._node_ids)
        return True

    def _set_up(self) -> None:  # noqa: B027 (a protocol may have none)
        """Check and configure the drives, which have all answered."""

    def _await_drives(self, timeout_s: float, must_end: Callable[[], bool]) -> bool:
        """Repeat requests until all drives have answered; return false if it must end before.

        Raises:
            DriveError: some have not within `timeout_s`.
        """
        give_up_s = time.monotonic() + timeout_s
        self._absent = set(self._joint_of.values())
        while self._absent and not must_end():
            self._ask()
            again_s = time.monotonic() + self.ask_again_s
            while self._absent and time.monotonic() < again_s and not must_end():
                self._listen()
            if self._absent and time.monotonic() > give_up_s:
                raise DriveError(self._who_is_absent(timeout_s))
        return not self._absent

    def _ask(self) -> None:  # noqa: B027 (a protocol may enable drives in another way)
        """Send requests to the drives that have not answered yet."""

    def _listen(self) -> None:
        """Wait briefly for answers, and note the drives that are ready: here, those with power."""
        frame = self._bus.receive(POLL_S)
        if frame is not None:
            self._handle(frame)
        self._absent = {joint for joint, is_on in enumerate(self._is_powered) if not is_on}

    def _who_is_absent(self, timeout_s: float) -> str:
        return f"no answer from drive {self._addresses(self._absent)} within {timeout_s:g} s"

    def skip_late(self) -> None:
        """Process pending frames; states among them answer a past sampling.

        A state left in the queue would count as the answer to the next sampling, and so on for the
        rest of the run.
        """
        for _ in range(_MOST_LATE):  # on a flooded bus there is no end of them
            frame = self._bus.receive(0.0)
            if frame is None:
                return
            self._take_in(frame, *self._skipped)

    def sample(self, now_ns: int) -> None:
        """Request the states of all drives; `now_ns` is the time of the run."""
        self._now_ns = now_ns
        if self._is_heartbeat_due():
            self._send_heartbeat()
            self._next_heartbeat_ns = now_ns + self._can.heartbeat_ms * 1_000_000
        self._samplings += 1
        self._awaited = set(self._joint_of.values()) - self._silent
        self._send(self._codec.sampling_frames())

    def read(self, timeout_s: float, position: Vector, velocity: Vector) -> bool:
        """Read the answers of all drives; return false if some are missing after `timeout_s`.

        Args:
            timeout_s: wall time.
            position: receives positions, rad, shape (joints,).
            velocity: receives velocities, rad/s, shape (joints,).

        Raises:
            SilentDriveError: a drive sends no states while others do.
            DriveError: a drive reports a fault, stopped following, or fell silent.
        """
        give_up_s = time.monotonic() + timeout_s
        while self._awaited:
            frame = self._bus.receive(max(0.0, give_up_s - time.monotonic()))
            if frame is None:
                break
            joint = self._take_in(frame, position, velocity)
            if joint is not None:
                self._awaited.discard(joint)
        faults, self._faults = [*self._missed_heartbeats(), *self._faults], []
        if faults and not self._is_stopping:
            if silent := self._without_states():
                raise SilentDriveError("; ".join(dict.fromkeys([*silent, *faults])))
            raise DriveError("; ".join(dict.fromkeys(faults)))
        return not self._awaited

    def _without_states(self) -> list[str]:
        """Return a sentence for each drive without states for a long time, if others sent some.

        Long is nearly the shortest timeout that depends on states.
        """
        long_ms = _NEARLY * min(self._can.command_timeout_ms, self._can.heartbeat_timeout_ms)
        ages_ms = [1e-6 * (self._now_ns - last_ns) for last_ns in self._last_answer_ns]
        if min(ages_ms) > long_ms:  # the bus, or all that is on it
            return []
        return [
            f"drive {node_id}: no state for {age_ms:.0f} ms"
            for node_id, age_ms in zip(self._node_ids, ages_ms, strict=True)
            if age_ms > long_ms
        ]

    def missing(self) -> str:
        """Addresses of the drives that have not answered yet, in words."""
        return self._addresses(self._awaited)

    def _addresses(self, joints: set[int]) -> str:
        return ", ".join(str(self._node_ids[joint]) for joint in sorted(joints))

    def strangers(self) -> str:
        """Describe other masters and drives, and another frame format; empty if there are none."""
        sentences = [
            f"states came in {count} {format_} frames, and link.can.fd_process_data is"
            f" {str(self._can.fd_process_data).lower()}: drives and scenario must agree"
            for format_, count in self._other_format.items()
        ]
        if self._strangers:
            what = ", ".join(f"{name} ({count})" for name, count in self._strangers.items())
            sentences.append(f"another master is on this bus: it sent {what}")
        for node_id, joint in self._joint_of.items():
            if self._answers[joint] > self._samplings:
                sentences.append(
                    f"drive {node_id} sent {self._answers[joint]} states for {self._samplings}"
                    " requests: another drive has its address, or another master sends requests"
                )
        return "; ".join(sentences)

    def command(self, torque_nm: Vector) -> None:
        """Send torques, shape (joints,), with the last target if there is one and no stop."""
        target = None if self._is_stopping else self._target
        self._send(self._codec.command_frames(torque_nm, target))

    def aim(self, target: Matrix) -> None:
        """Set the targets of drives with position loops. They are sent with the next torques.

        Args:
            target: positions, rad, and velocities, rad/s, as rows, shape (2, joints); NaN for none.
        """
        self._target = None if np.isnan(target).any() else target

    def begin_stop(self) -> None:
        """Bring the drives to rest from now on, in spite of torques; faults are expected."""
        self._is_stopping = True

    def give_up(self) -> None:
        """Stop waiting for the drives that have not answered; they count as silent."""
        self._silent |= self._awaited
        self._awaited = set()

    def is_stopped(self) -> bool:
        """Whether all drives that still answer have switched their power stages off."""
        return not any(
            is_powered and joint not in self._silent
            for joint, is_powered in enumerate(self._is_powered)
        )

    @abstractmethod
    def leave(self) -> None:
        """Leave the drives in the state in which they wait for a master."""

    def _send_heartbeat(self) -> None:  # noqa: B027 (a protocol may have none)
        """Send the heartbeat, which is due every `heartbeat_ms`."""

    def _only_master_sends(self, _frame: CanFrame) -> str | None:
        """Return the name of a frame that only a master sends to these drives; None for others."""
        return None

    def _handle_report(self, frame: CanFrame) -> None:  # noqa: B027 (a protocol may have none)
        """Process a data frame that is no state, and note the faults it reports."""

    def _missed_heartbeats(self) -> list[str]:
        """Return a sentence for each overdue heartbeat; here, drives have none."""
        return []

    def _take_in(self, frame: CanFrame, position: Vector, velocity: Vector) -> int | None:
        """Process any frame; return the joint whose state it contains, or None."""
        joint = self._codec.read_state(frame, position, velocity)
        if joint is None:
            self._handle(frame)
        else:
            self._answers[joint] += 1
            self._last_answer_ns[joint] = self._now_ns
        return joint

    def _is_heartbeat_due(self) -> bool:
        return self._now_ns >= self._next_heartbeat_ns

    def _handle(self, frame: CanFrame) -> None:
        """Process a frame without a state: error frames of the local controller, reports."""
        self._note_stranger(frame)
        if frame.is_error:
            if frame.identifier & BUS_OFF:
                self._faults.append("the CAN controller is bus-off")
        elif not (frame.is_extended or frame.is_remote):
            self._handle_report(frame)

    def _note_stranger(self, frame: CanFrame) -> None:
        """Count frames that only a master sends: a node never receives its own frames.

        Also count states in the other frame format, CAN FD or classical.
        """
        if frame.is_error or frame.is_extended:
            return
        other = frame._replace(is_fd=not frame.is_fd)
        if self._codec.read_state(other, *self._skipped) is not None:
            self._other_format["CAN FD" if frame.is_fd else "classical"] += 1
        if frame.is_fd and not self._can.fd_process_data:
            return
        name = self._only_master_sends(frame)
        if name is not None:
            self._strangers[name] += 1

    def _send(self, frames: Iterable[CanFrame]) -> None:
        self._bus.send_all(tuple(frames))
