"""ODrive axes in position control: their cyclic frames, and their master.

A cycle is, for each axis, a remote frame that asks for its encoder estimates, the answer, and
``Set_Input_Pos`` with velocity and torque feed-forward, each 16 bits in steps that the axis and its
master must agree on (``input_vel_scale``, ``input_torque_scale``).
"""

from __future__ import annotations

import math
import struct
from collections.abc import Callable, Sequence

import numpy as np

from bus_schema.arrays import Matrix, Vector
from bus_schema.can.cansimple.codec import SET_INPUT_POS, CanSimpleCodec, identifier
from bus_schema.can.cansimple.master import CanSimpleMaster
from bus_schema.can.frame import CanBus, CanFrame, is_classical_data
from bus_schema.can.frame_timing import CycleFrames
from bus_schema.can.position.aiming import AimingCodec, AimingMaster
from bus_schema.drive_feedback import DriveGains
from bus_schema.link.can_configuration import CanConfiguration, CanSimpleConfiguration

_SET_POS_GAIN, _SET_VEL_GAINS = 0x1A, 0x1B
_INPUT, _GAIN, _GAINS = struct.Struct("<fhh"), struct.Struct("<f"), struct.Struct("<ff")
_TURN_RAD = 2.0 * math.pi
_WORD = np.iinfo(np.int16)


class CanSimplePositionCodec(AimingCodec, CanSimpleCodec):
    """Frames of one control cycle, see `TargetCodec` and `AimingCodec`.

    Args:
        node_ids: addresses of the axes, one for each joint.
        scales: of the feed-forwards.
    """

    cycle = CycleFrames(
        (), (0, 8, 8), "{n} × (request + encoder estimates 8 bytes + position 8 bytes)"
    )

    def __init__(self, node_ids: Sequence[int], scales: CanSimpleConfiguration) -> None:
        super().__init__(node_ids)
        self._scales = scales
        self._inputs = [identifier(node_id, SET_INPUT_POS) for node_id in node_ids]
        self._joint_of_input = {each: joint for joint, each in enumerate(self._inputs)}
        self._seen = np.zeros((2, len(node_ids)))

    def read_torque(self, frame: CanFrame, torque_nm: Vector) -> int | None:
        joint = self._joint_of_input.get(frame.identifier)
        if joint is None or not is_classical_data(frame, _INPUT.size):
            return None
        torque_nm[joint] = _INPUT.unpack(frame.data)[2] / self._scales.input_torque_scale
        return joint

    def _frames(self, torque_nm: Vector, target: Matrix) -> list[CanFrame]:
        turns, turns_s = target / _TURN_RAD
        rows = zip(
            self._inputs, turns.tolist(),
            _words(turns_s * self._scales.input_vel_scale),
            _words(torque_nm * self._scales.input_torque_scale), strict=True,
        )  # fmt: skip
        return [CanFrame(each, _INPUT.pack(*values)) for each, *values in rows]


class CanSimplePositionMaster(AimingMaster, CanSimpleMaster):
    """The master, which sets the axes' gains; their integrals are off.

    Args:
        gains: of the axes' loops.
        others: as in `CanSimpleMaster`.
    """

    mode = 3
    _codec: CanSimplePositionCodec

    def __init__(
        self,
        bus: CanBus,
        can: CanConfiguration,
        node_ids: tuple[int, ...],
        codec: CanSimplePositionCodec,
        gains: DriveGains,
    ) -> None:
        super().__init__(bus, can, node_ids, codec)
        self._gains = gains

    def _try_to_enable(self, is_stop_requested: Callable[[], bool]) -> bool:
        rows = zip(
            self._node_ids, self._gains.stiffness_nm_rad.tolist(),
            self._gains.damping_nm_s.tolist(), strict=True,
        )  # fmt: skip
        for node_id, stiffness, damping in rows:
            position_gain = stiffness / damping if damping else 0.0
            self._send(
                (
                    CanFrame(identifier(node_id, _SET_POS_GAIN), _GAIN.pack(position_gain)),
                    CanFrame(
                        identifier(node_id, _SET_VEL_GAINS), _GAINS.pack(damping * _TURN_RAD, 0.0)
                    ),
                )
            )
        return super()._try_to_enable(is_stop_requested)


def _words(values: Vector) -> list[int]:
    return [int(each) for each in np.clip(np.rint(values), _WORD.min, _WORD.max).tolist()]
