"""The ROS 2 message types on the bus: standard ones and our own from ``msg/*.msg``.

Each begins with a header, whose stamp is seconds and nanoseconds, or one number here. On the wire
(CDR, little endian) it follows the encapsulation directly.
"""

from __future__ import annotations

import struct
from importlib import resources
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

PACKAGE = "funnel_hil_msgs"
JOINT_STATE = "sensor_msgs/msg/JointState"
STRING = "std_msgs/msg/String"
TF_MESSAGE = "tf2_msgs/msg/TFMessage"
CLOCK = "rosgraph_msgs/msg/Clock"
PLANT_STATUS = f"{PACKAGE}/msg/PlantStatus"
PLANT_TRUTH = f"{PACKAGE}/msg/PlantTruth"
CONTROL_STATUS = f"{PACKAGE}/msg/ControlStatus"
RUN_EVENT = f"{PACKAGE}/msg/RunEvent"

NANOSECONDS = 1_000_000_000
SEC, NANOSEC = "header.stamp.sec", "header.stamp.nanosec"
"""Names of both parts in a message's layout."""
ENCAPSULATION_BYTES = 4
_STAMP = struct.Struct("<iI")
_END = ENCAPSULATION_BYTES + _STAMP.size

# The few standard ones that we use, as ROS 2 has them: a store of a whole distribution takes
# longer to load than Python does to start.
_STANDARD = {
    "builtin_interfaces/msg/Time": "int32 sec\nuint32 nanosec",
    "std_msgs/msg/Header": "builtin_interfaces/Time stamp\nstring frame_id",
    JOINT_STATE: "std_msgs/Header header\nstring[] name\n"
    "float64[] position\nfloat64[] velocity\nfloat64[] effort",
    STRING: "string data",
    CLOCK: "builtin_interfaces/Time clock",
    "geometry_msgs/msg/Vector3": "float64 x\nfloat64 y\nfloat64 z",
    "geometry_msgs/msg/Quaternion": "float64 x 0\nfloat64 y 0\nfloat64 z 0\nfloat64 w 1",
    "geometry_msgs/msg/Transform": "geometry_msgs/Vector3 translation\n"
    "geometry_msgs/Quaternion rotation",
    "geometry_msgs/msg/TransformStamped": "std_msgs/Header header\n"
    "string child_frame_id\ngeometry_msgs/Transform transform",
    TF_MESSAGE: "geometry_msgs/TransformStamped[] transforms",
}


def _load_typestore() -> Typestore:
    store = get_typestore(Stores.EMPTY)
    types: dict[str, Any] = {}
    for name, text in _STANDARD.items():
        types.update(get_types_from_msg(text, name))
    for file in sorted(
        resources.files("bus_schema.messages").joinpath("msg").iterdir(), key=lambda f: f.name
    ):
        if file.name.endswith(".msg"):
            name = f"{PACKAGE}/msg/{file.name.removesuffix('.msg')}"
            types.update(get_types_from_msg(file.read_text(encoding="utf-8"), name))
    store.register(types)
    return store


TYPESTORE = _load_typestore()


def type_hash(type_name: str) -> str:
    """Return the RIHS01 hash of a type (REP-2016), as rmw_zenoh puts it in key expressions."""
    return TYPESTORE.hash_rihs01(type_name)


def schema_text(type_name: str) -> str:
    """Return a type's definition with all its dependencies, in MCAP's ``ros2msg`` encoding."""
    return TYPESTORE.generate_msgdef(type_name, ros_version=2)[0]


def has_todays_form(type_name: str, text: bytes) -> bool:
    """Whether a recorded schema matches today's type."""
    try:
        recorded = get_types_from_msg(text.decode(), type_name)
    except Exception:  # noqa: BLE001 (rosbags raises many kinds of errors)
        return False
    todays = TYPESTORE.fielddefs
    return all(name in todays and todays[name][1] == recorded[name][1] for name in recorded)


def split_stamp(stamp_ns: int) -> tuple[int, int]:
    """Split a stamp in ns into seconds and nanoseconds."""
    return divmod(stamp_ns, NANOSECONDS)


def join_stamp(sec: int, nanosec: int) -> int:
    """Return a stamp in ns from both parts."""
    return sec * NANOSECONDS + nanosec


def stamp_of(payload: bytes) -> int | None:
    """Return the stamp of an encoded message, ns; None if it is missing or negative."""
    if len(payload) < _END:
        return None
    stamp_ns = join_stamp(*_STAMP.unpack_from(payload, ENCAPSULATION_BYTES))
    return stamp_ns if stamp_ns >= 0 else None


def with_stamp(payload: bytes, stamp_ns: int) -> bytes:
    """Return an encoded message with another stamp."""
    return payload[:ENCAPSULATION_BYTES] + _STAMP.pack(*split_stamp(stamp_ns)) + payload[_END:]


def stamps_ns(table: NDArray[np.void]) -> NDArray[np.int64]:
    """Return the stamps of a table of messages (`MessageLayout.tabulate`), shape (messages,)."""
    stamps: NDArray[np.int64] = table[SEC].astype(np.int64) * NANOSECONDS + table[NANOSEC]
    return stamps
