"""Master of ODrive axes on CANSimple, in torque control."""

from __future__ import annotations

import struct
import time
from collections.abc import Callable

import numpy as np

from bus_schema.arrays import Vector
from bus_schema.can.cansimple_codec import (
    CLEAR_ERRORS,
    COMMAND_BITS,
    HEARTBEAT,
    SET_AXIS_STATE,
    SET_CONTROLLER_MODE,
    CanSimpleCodec,
    identifier,
)
from bus_schema.can.frame import CanBus, CanFrame
from bus_schema.can.master import DriveError, Roll, bus_fault
from bus_schema.link.can_configuration import CanConfiguration

_IDLE, _CLOSED_LOOP_CONTROL = 1, 8
_TORQUE_CONTROL, _PASSTHROUGH = 1, 1
_U32, _TWO_U32 = struct.Struct("<I"), struct.Struct("<II")
_BEAT = struct.Struct("<IBB")
_COMMAND_MASK = (1 << COMMAND_BITS) - 1
_POLL_S = 0.05
_AGAIN_S = 0.3


class CanSimpleMaster:
    """The master. What an axis is doing, its heartbeats tell; they can be asked for.

    Args:
        bus: where the axes are.
        can: section ``link.can`` of the scenario.
        node_ids: addresses of the axes, one for each joint.
        codec: the frames of a cycle.
    """

    def __init__(
        self, bus: CanBus, can: CanConfiguration, node_ids: tuple[int, ...], codec: CanSimpleCodec
    ) -> None:
        self._bus, self._can, self._codec = bus, can, codec
        self._node_ids = node_ids
        self._joint_of = {node_id: joint for joint, node_id in enumerate(node_ids)}
        self._roll = Roll(node_ids)
        self._states = [0] * len(node_ids)
        self._errors = [0] * len(node_ids)
        self._next_question_ns = 0
        self._is_stopping = False
        self._faults: list[str] = []
        self._zero: Vector = np.zeros(len(node_ids))

    def enable(self, timeout_s: float, is_stop_requested: Callable[[], bool]) -> bool:
        give_up_s = time.monotonic() + timeout_s
        while True:
            if self._try_to_enable(is_stop_requested):
                break
            if is_stop_requested():
                return False
            if time.monotonic() > give_up_s:
                raise DriveError(self._not_enabled(timeout_s))
        self._faults.clear()
        return True

    def sample(self, now_ns: int) -> None:
        if now_ns >= self._next_question_ns or self._is_stopping:
            self._send_to_all(HEARTBEAT, is_remote=True)
            self._next_question_ns = now_ns + self._can.heartbeat_ms * 1_000_000
        self._roll.call()
        for frame in self._codec.sampling_frames():
            self._bus.send(frame)

    def read(self, timeout_s: float, position: Vector, velocity: Vector) -> bool:
        give_up_s = time.monotonic() + timeout_s
        while not self._roll.is_complete:
            frame = self._bus.receive(max(0.0, give_up_s - time.monotonic()))
            if frame is None:
                break
            joint = self._codec.read_state(frame, position, velocity)
            if joint is None:
                self._hear(frame)
            else:
                self._roll.answered(joint)
        faults, self._faults = self._faults, []
        if faults and not self._is_stopping:
            raise DriveError("; ".join(dict.fromkeys(faults)))
        return self._roll.is_complete

    def missing(self) -> str:
        return self._roll.missing

    def command(self, torque_nm: Vector) -> None:
        if self._is_stopping:
            self._send_to_all(SET_AXIS_STATE, _U32.pack(_IDLE))
            torque_nm = self._zero
        for frame in self._codec.torque_frames(torque_nm):
            self._bus.send(frame)

    def begin_stop(self) -> None:
        self._is_stopping = True
        self._roll.give_up()

    def is_stopped(self) -> bool:
        return not any(
            state == _CLOSED_LOOP_CONTROL and joint not in self._roll.silent
            for joint, state in enumerate(self._states)
        )

    def leave(self) -> None:
        self._send_to_all(SET_AXIS_STATE, _U32.pack(_IDLE))

    def _try_to_enable(self, is_stop_requested: Callable[[], bool]) -> bool:
        """Ask all axes to follow torques, and hear for a while whether they do."""
        self._states = [0] * len(self._node_ids)
        self._send_to_all(CLEAR_ERRORS, b"\0")
        self._send_to_all(SET_CONTROLLER_MODE, _TWO_U32.pack(_TORQUE_CONTROL, _PASSTHROUGH))
        self._send_to_all(SET_AXIS_STATE, _U32.pack(_CLOSED_LOOP_CONTROL))
        self._send_to_all(HEARTBEAT, is_remote=True)
        until_s = time.monotonic() + _AGAIN_S
        while time.monotonic() < until_s and not is_stop_requested():
            frame = self._bus.receive(_POLL_S)
            if frame is not None:
                self._hear(frame)
            if all(state == _CLOSED_LOOP_CONTROL for state in self._states):
                return True
        return False

    def _not_enabled(self, timeout_s: float) -> str:
        sentences = []
        for node_id, state, errors in zip(self._node_ids, self._states, self._errors, strict=True):
            if state == 0:
                sentences.append(f"no answer from axis {node_id} within {timeout_s:g} s")
            elif state != _CLOSED_LOOP_CONTROL:
                sentences.append(f"axis {node_id} stays in state {state}, errors 0x{errors:X}")
        return "; ".join(sentences)

    def _hear(self, frame: CanFrame) -> None:
        if frame.is_error:
            if (fault := bus_fault(frame)) is not None:
                self._faults.append(fault)
            return
        node_id = frame.identifier >> COMMAND_BITS
        joint = self._joint_of.get(node_id)
        is_beat = frame.identifier & _COMMAND_MASK == HEARTBEAT and not frame.is_extended
        if joint is None or not is_beat or len(frame.data) < _BEAT.size:
            return
        self._errors[joint], self._states[joint], _ = _BEAT.unpack_from(frame.data)
        if self._errors[joint]:
            self._faults.append(f"axis {node_id}: error 0x{self._errors[joint]:X}")
        elif self._states[joint] != _CLOSED_LOOP_CONTROL:
            self._faults.append(f"axis {node_id}: state {self._states[joint]}, not closed loop")

    def _send_to_all(self, command: int, data: bytes = b"", *, is_remote: bool = False) -> None:
        for node_id in self._node_ids:
            self._bus.send(CanFrame(identifier(node_id, command), data, is_remote=is_remote))
