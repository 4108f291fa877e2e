"""Message types: the standard ones are those of ROS 2."""

from __future__ import annotations

import pytest
from rosbags.typesys import Stores, get_typestore

from bus_schema.messages.types import JOINT_STATE, schema_text, type_hash


@pytest.mark.parametrize(
    "name", ["builtin_interfaces/msg/Time", "std_msgs/msg/Header", JOINT_STATE]
)
def test_standard_types_are_those_of_ros_2(name):
    """A ROS 2 node on the bus takes a type for its own by this hash, a reader of MCAP by the text.

    Both from rosbags' definitions of the distribution whose key expressions we speak.
    """
    jazzy = get_typestore(Stores.ROS2_JAZZY)
    assert type_hash(name) == jazzy.hash_rihs01(name)
    assert schema_text(name) == jazzy.generate_msgdef(name, ros_version=2)[0]
