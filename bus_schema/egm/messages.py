"""Messages of EGM, as far as joints need them, in the numbering of ABB's public ``egm.proto``.

The descriptors are made at import, in a pool of their own: no generated file has to match the
installed protobuf, and a client's own ``egm_pb2`` may be loaded beside them.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from google.protobuf import descriptor_pb2, descriptor_pool, message_factory
from google.protobuf.message import DecodeError

from bus_schema.arrays import Matrix, Vector

_FIELDS: Mapping[str, Mapping[str, tuple[int, str]]] = {
    "EgmHeader": {"seqno": (1, "uint32"), "tm": (2, "uint32"), "mtype": (3, "uint32")},
    "EgmJoints": {"joints": (1, "doubles")},
    "EgmPlanned": {"joints": (1, "EgmJoints"), "externalJoints": (3, "EgmJoints")},
    "EgmSpeedRef": {"joints": (1, "EgmJoints"), "externalJoints": (3, "EgmJoints")},
    "EgmFeedBack": {"joints": (1, "EgmJoints"), "externalJoints": (3, "EgmJoints")},
    "EgmState": {"state": (1, "uint32")},
    "EgmRobot": {
        "header": (1, "EgmHeader"), "feedBack": (2, "EgmFeedBack"), "planned": (3, "EgmPlanned"),
        "motorState": (4, "EgmState"), "mciState": (5, "EgmState"),
        "mciConvergenceMet": (6, "bool"), "rapidExecState": (8, "EgmState"),
    },
    "EgmSensor": {
        "header": (1, "EgmHeader"), "planned": (2, "EgmPlanned"), "speedRef": (3, "EgmSpeedRef"),
    },
}  # fmt: skip
"""Number and type of each field, by message; enumerations are numbers, as they are on the wire."""
_DATA = 2
_MOTORS_ON, _RAPID_STOPPED, _RAPID_RUNNING = 1, 1, 2
MCI_STOPPED, MCI_RUNNING = 2, 3
_MS_PER_S, _SEQUENCE_NUMBERS = 1e3, 1 << 32


class Correction(NamedTuple):
    """Positions and velocities that a client asks for.

    Attributes:
        position_rad: shape (joints,); None if it gives none.
        velocity_rad_s: likewise.
    """

    position_rad: Vector | None
    velocity_rad_s: Vector | None


def _message_types() -> dict[str, Any]:
    file = descriptor_pb2.FileDescriptorProto(
        name="funnel_hil_egm.proto", package="abb.egm", syntax="proto2"
    )
    kinds = descriptor_pb2.FieldDescriptorProto
    scalars = {"uint32": kinds.TYPE_UINT32, "bool": kinds.TYPE_BOOL, "doubles": kinds.TYPE_DOUBLE}
    for name, fields in _FIELDS.items():
        message = file.message_type.add(name=name)
        for field, (number, kind) in fields.items():
            label = kinds.LABEL_REPEATED if kind == "doubles" else kinds.LABEL_OPTIONAL
            made = message.field.add(name=field, number=number, label=label)
            if kind in scalars:
                made.type = scalars[kind]
            else:
                made.type, made.type_name = kinds.TYPE_MESSAGE, f".abb.egm.{kind}"
    pool = descriptor_pool.DescriptorPool()
    pool.Add(file)
    return {
        name: message_factory.GetMessageClass(pool.FindMessageTypeByName(f"abb.egm.{name}"))
        for name in ("EgmRobot", "EgmSensor")
    }


_TYPES = _message_types()


def robot_message(number: int, now_s: float, measured: Matrix, planned: Matrix, mci: int) -> bytes:
    """Return an ``EgmRobot``.

    Args:
        number: of the message.
        now_s: time since the controller began.
        measured: positions and velocities as rows, shape (2, joints), rad and rad/s.
        planned: those that the robot's controller plans, likewise.
        mci: `MCI_RUNNING` while corrections move the robot, otherwise `MCI_STOPPED`.
    """
    message, runs = _TYPES["EgmRobot"](), mci == MCI_RUNNING
    message.header.seqno = number % _SEQUENCE_NUMBERS
    message.header.tm = round(_MS_PER_S * now_s) % _SEQUENCE_NUMBERS
    message.header.mtype = _DATA
    message.feedBack.joints.joints.extend(np.degrees(measured[0]).tolist())
    message.planned.joints.joints.extend(np.degrees(planned[0]).tolist())
    message.motorState.state = _MOTORS_ON
    message.mciState.state = mci
    message.mciConvergenceMet = False
    message.rapidExecState.state = _RAPID_RUNNING if runs else _RAPID_STOPPED
    data: bytes = message.SerializeToString()
    return data


def read_correction(data: bytes, joints: int, most_rad: float, most_rad_s: float) -> Correction:
    """Read an ``EgmSensor``.

    Args:
        data: a datagram.
        joints: number of the robot's joints.
        most_rad: largest position.
        most_rad_s: largest velocity.

    Raises:
        ValueError: it is none, or its values cannot be used; the message says which.
    """
    message = _TYPES["EgmSensor"]()
    try:
        message.ParseFromString(data)
    except DecodeError as error:
        raise ValueError(f"a message that is no EgmSensor: {error}") from error
    found = Correction(
        _joints(message.planned, "planned", joints, most_rad),
        _joints(message.speedRef, "speedRef", joints, most_rad_s),
    )
    if found.position_rad is None and found.velocity_rad_s is None:
        raise ValueError("a message without planned.joints and speedRef.joints")
    return found


def _joints(part: Any, name: str, joints: int, most: float) -> Vector | None:
    """Return the values of a part in rad or rad/s; None if it has none."""
    degrees = [*part.joints.joints, *part.externalJoints.joints]
    if not degrees:
        return None
    if len(degrees) != joints:
        raise ValueError(f"{name}: {len(degrees)} joints: must be {joints}")
    bound = math.degrees(most)
    for number, value in enumerate(degrees):
        if not abs(value) <= bound:  # NaN is in no range
            raise ValueError(f"{name}: joint {number} = {value:g}: must be within ±{bound:g}")
    return np.radians(degrees)
