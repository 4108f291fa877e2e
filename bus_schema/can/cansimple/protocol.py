"""ODrive's CANSimple: its settings in a scenario, and the master of its axes."""

from __future__ import annotations

import struct
from collections.abc import Sequence

import numpy as np

from bus_schema.arrays import Vector
from bus_schema.can.cansimple.codec import (
    COMMAND_BITS,
    PASSTHROUGH,
    TURN_RAD,
    CanSimpleCodec,
    CommandId,
    OdriveState,
    identifier,
)
from bus_schema.can.frame import CanBus, CanFrame, is_data
from bus_schema.can.master import CanMaster
from bus_schema.can.protocol import DriveProtocol
from bus_schema.configuration import ConfigurationError
from bus_schema.drive_feedback import DriveGains
from bus_schema.link.can_configuration import CanConfiguration, CanSimpleConfiguration
from bus_schema.robot_description import RobotDescription

_U32, _TWO_U32 = struct.Struct("<I"), struct.Struct("<II")
_GAIN, _GAINS = struct.Struct("<f"), struct.Struct("<ff")
_BEAT = struct.Struct("<IBB")
_OF_MASTER = {
    CommandId.SET_AXIS_STATE, CommandId.SET_CONTROLLER_MODE, CommandId.SET_INPUT_POS,
    CommandId.SET_INPUT_TORQUE, CommandId.CLEAR_ERRORS,
}  # fmt: skip
"""Commands that only a master sends."""


class CanSimpleMaster(CanMaster):
    """The master; the arguments are those of `CanMaster`.

    Heartbeats report the state of an axis; they can be requested. In position control the master
    sets the gains of the axes, without integral.
    """

    _codec: CanSimpleCodec

    def __init__(
        self, bus: CanBus, can: CanConfiguration, node_ids: tuple[int, ...], codec: CanSimpleCodec
    ) -> None:
        super().__init__(bus, can, node_ids, codec)
        self._states = [0] * len(node_ids)
        self._errors = [0] * len(node_ids)

    def _set_up(self) -> None:
        self._faults.clear()

    def command(self, torque_nm: Vector) -> None:
        if self._is_stopping:
            self._send_to_all(CommandId.SET_AXIS_STATE, _U32.pack(OdriveState.IDLE))
            torque_nm = np.zeros_like(torque_nm)
        super().command(torque_nm)

    def leave(self) -> None:
        self._send_to_all(CommandId.SET_AXIS_STATE, _U32.pack(OdriveState.IDLE))

    def _ask(self) -> None:
        """Ask all axes to follow their inputs, and for the heartbeats that say whether they do."""
        self._send_gains()
        self._states = [0] * len(self._node_ids)
        self._is_powered = [False] * len(self._node_ids)
        self._send_to_all(CommandId.CLEAR_ERRORS, b"\0")
        self._send_to_all(
            CommandId.SET_CONTROLLER_MODE, _TWO_U32.pack(self._codec.mode.control, PASSTHROUGH)
        )
        self._send_to_all(CommandId.SET_AXIS_STATE, _U32.pack(OdriveState.CLOSED_LOOP_CONTROL))
        self._send_heartbeat()

    def _send_gains(self) -> None:
        """Tune the loops that axes close in position control."""
        if self._codec.gains is None:
            return
        _, stiffnesses, dampings = self._codec.gains
        rows = zip(self._node_ids, stiffnesses.tolist(), dampings.tolist(), strict=True)
        for node_id, stiffness, damping in rows:
            position = _GAIN.pack(stiffness / damping)
            velocity = _GAINS.pack(damping * TURN_RAD, 0.0)
            self._send((
                CanFrame(identifier(node_id, CommandId.SET_POS_GAIN), position),
                CanFrame(identifier(node_id, CommandId.SET_VEL_GAINS), velocity),
            ))  # fmt: skip

    def _who_is_absent(self, timeout_s: float) -> str:
        sentences = []
        for node_id, state, errors in zip(self._node_ids, self._states, self._errors, strict=True):
            if state == 0:
                sentences.append(f"no answer from axis {node_id} within {timeout_s:g} s")
            elif state != OdriveState.CLOSED_LOOP_CONTROL:
                sentences.append(f"axis {node_id} stays in state {state}, errors 0x{errors:X}")
        return "; ".join(sentences)

    def _is_heartbeat_due(self) -> bool:
        return self._is_stopping or super()._is_heartbeat_due()

    def _send_heartbeat(self) -> None:
        """Request the heartbeats of all axes; they need none of the master's."""
        self._send_to_all(CommandId.HEARTBEAT, is_remote=True)

    def _only_master_sends(self, frame: CanFrame) -> str | None:
        node_id, command = divmod(frame.identifier, 1 << COMMAND_BITS)
        if node_id not in self._joint_of:
            return None
        if frame.is_remote:
            return "requests"
        return CommandId(command).name.title() if command in _OF_MASTER else None

    def _handle_report(self, frame: CanFrame) -> None:
        """Take in heartbeats."""
        node_id, command = divmod(frame.identifier, 1 << COMMAND_BITS)
        joint = self._joint_of.get(node_id)
        if joint is None or command != CommandId.HEARTBEAT or len(frame.data) < _BEAT.size:
            return
        self._errors[joint], self._states[joint], _ = _BEAT.unpack_from(frame.data)
        self._is_powered[joint] = self._states[joint] == OdriveState.CLOSED_LOOP_CONTROL
        if self._errors[joint]:
            self._faults.append(f"axis {node_id}: error 0x{self._errors[joint]:X}")
        elif not self._is_powered[joint]:
            self._faults.append(f"axis {node_id}: state {self._states[joint]}, not closed loop")

    def _send_to_all(self, command: int, data: bytes = b"", *, is_remote: bool = False) -> None:
        self._send(
            CanFrame(identifier(node_id, command), data, is_remote=is_remote)
            for node_id in self._node_ids
        )


_LARGEST_WORD = 32_767
_BEAT_BYTES = 8


class CanSimpleProtocol(DriveProtocol):
    """CANSimple in torque control; with gains, in position control."""

    title = "CANSimple"
    largest_node_id = 63
    takes_targets = True
    master = CanSimpleMaster

    def codec(
        self, can: CanConfiguration, robot: RobotDescription, gains: DriveGains | None = None
    ) -> CanSimpleCodec:
        if gains is not None:
            _check_position_control(can, robot, gains)
        return CanSimpleCodec(self.node_ids(can, robot.joints), gains, can.cansimple)

    def questions(self, can: CanConfiguration, node_id: int) -> Sequence[CanFrame]:  # noqa: ARG002
        return [CanFrame(identifier(node_id, CommandId.HEARTBEAT), is_remote=True)]

    def answer(self, frame: CanFrame) -> tuple[int, str, float] | None:
        node_id, command = divmod(frame.identifier, 1 << COMMAND_BITS)
        is_beat = command == CommandId.HEARTBEAT and is_data(frame, _BEAT_BYTES)
        return (node_id, "heartbeat", 1.0) if is_beat and node_id else None

    def own_settings(
        self, can: CanConfiguration, robot: RobotDescription
    ) -> tuple[CanSimpleConfiguration, ...]:
        return (can.cansimple,) * robot.joints


def _check_position_control(
    can: CanConfiguration, robot: RobotDescription, gains: DriveGains
) -> None:
    scale = can.cansimple.input_torque_scale
    most_nm = float(robot.effort_limits_nm.max())
    if most_nm * scale > _LARGEST_WORD:
        raise ConfigurationError(
            "link.can.cansimple.input_torque_scale", scale,
            f"must be at most {_LARGEST_WORD / most_nm:.4g} for the torque feed-forward of"
            f" {most_nm:g} N m to go with a position, which has 16 bits for it",
        )  # fmt: skip
    if not (gains.damping_nm_s > 0.0).all():
        raise ConfigurationError(
            "plant.drive_feedback.damping_nm_s", gains.damping_nm_s.tolist(),
            "must be more than 0 with CANSimple: the position loop is around the velocity loop",
        )  # fmt: skip
