"""Poses as tf2_msgs/TFMessage, whose bytes are laid out once for an arm's links.

`bus_schema.messages.layout` does the same for messages without sequences of messages.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from bus_schema.messages.cdr_types import Cursor
from bus_schema.messages.header import split_stamp
from bus_schema.messages.types import TF_MESSAGE, TYPESTORE
from bus_schema.view.link_poses import CarriedLink, Poses

_STAMP, _POSE = np.dtype(("<u4", 2)), np.dtype(("<f8", 7))


class TransformLayout:
    """Wire layout of the transforms of these links.

    Args:
        links: whose poses will be sent, in their order.
    """

    def __init__(self, links: Sequence[CarriedLink]) -> None:
        self._storage = np.frombuffer(_template(links), np.uint8).copy()
        stamps, poses = _places(links)
        self._stamps = stamps[:, None] + np.arange(_STAMP.itemsize)
        self._poses = poses[:, None] + np.arange(_POSE.itemsize)

    def encode(self, stamp_ns: int, poses: Poses) -> bytes:
        """The message.

        Args:
            stamp_ns: when the links are there.
            poses: shape (links, 7).
        """
        self._storage[self._stamps] = np.array(split_stamp(stamp_ns), "<u4").view(np.uint8)
        self._storage[self._poses] = np.ascontiguousarray(poses, "<f8").view(np.uint8)
        return self._storage.tobytes()


def _template(links: Sequence[CarriedLink]) -> bytes:
    """The message as rosbags writes it, with all links at their parents' origins."""
    types = TYPESTORE.types
    time, header = types["builtin_interfaces/msg/Time"], types["std_msgs/msg/Header"]
    vector, quaternion = types["geometry_msgs/msg/Vector3"], types["geometry_msgs/msg/Quaternion"]
    pose = types["geometry_msgs/msg/Transform"](
        vector(0.0, 0.0, 0.0), quaternion(0.0, 0.0, 0.0, 1.0)
    )
    stamped = types["geometry_msgs/msg/TransformStamped"]
    transforms = [stamped(header(time(0, 0), link.parent), link.child, pose) for link in links]
    return bytes(TYPESTORE.serialize_cdr(types[TF_MESSAGE](transforms), TF_MESSAGE))


def _places(links: Sequence[CarriedLink]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Where in the bytes the stamps and the poses are."""
    cursor = Cursor()
    cursor.take(4, 4)
    stamps, poses = [], []
    for link in links:
        stamps.append(cursor.take(_STAMP.itemsize, 4))
        cursor.skip_strings([link.parent, link.child], counted=False)
        poses.append(cursor.take(_POSE.itemsize, 8))
    return np.array(stamps, np.int64), np.array(poses, np.int64)
