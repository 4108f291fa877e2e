"""What makes a recording or a live bus visible in 3-D: the arm, and where its links are.

A robot_state_publisher: it reads joint states, as they were delivered, and nothing else of a run.
"""

from __future__ import annotations

import numpy as np

from bus_schema.errors import InvalidMessageError
from bus_schema.messages.header import NANOSECONDS
from bus_schema.messages.layout import Record
from bus_schema.messages.topics import JOINT_STATES, ROBOT_DESCRIPTION, TF_STATIC, Topic, layout
from bus_schema.messages.types import STRING, TYPESTORE
from bus_schema.robot_description import RobotDescription
from bus_schema.view.link_poses import LinkPoses
from bus_schema.view.ros2_control import with_ros2_control
from bus_schema.view.transforms import TransformLayout

_PERIOD_NS = NANOSECONDS // 60
"""Between two pictures: more often no screen shows them."""


def description(robot: RobotDescription) -> str:
    """The URDF as `ROBOT_DESCRIPTION` has it: for viewers, and for ros2_control."""
    return with_ros2_control(robot.viewer_urdf(), robot.joint_names)


class ArmView:
    """Makes messages on `VIEW_TOPICS`.

    Args:
        robot: the arm.
    """

    def __init__(self, robot: RobotDescription) -> None:
        self._robot = robot
        self._poses = LinkPoses(robot)
        self._transforms = TransformLayout(self._poses.moving)
        self._layout = layout(JOINT_STATES, robot.joint_names)
        self._state = Record(self._layout)
        self._last_ns: int | None = None

    def first(self) -> list[tuple[Topic, bytes]]:
        """What is sent once: the URDF, and where links are that do not move."""
        text = TYPESTORE.types[STRING](description(self._robot))
        static = TransformLayout(self._poses.fixed)
        return [
            (ROBOT_DESCRIPTION, bytes(TYPESTORE.serialize_cdr(text, STRING))),
            (TF_STATIC, static.encode(0, self._poses.fixed_poses)),
        ]

    def transforms(self, state: bytes, stamp_ns: int) -> bytes | None:
        """The transforms to send on `TF` with a joint state; None where no picture is due.

        Args:
            state: the joint state as it came; one that nobody can read has no picture.
            stamp_ns: its stamp.
        """
        if self._last_ns is not None and abs(stamp_ns - self._last_ns) < _PERIOD_NS:
            return None
        try:
            self._layout.decode(state, self._state)
        except InvalidMessageError:
            return None
        position = self._state.fields["position"]
        if not np.isfinite(position).all():
            return None
        self._last_ns = stamp_ns
        return self._transforms.encode(stamp_ns, self._poses.moving_poses(position))
