import re

import pytest
from rosbags.typesys import Stores, get_typestore

from bus_schema.messages.topics import JOINT_COMMANDS, JOINT_STATES, TOPICS
from bus_schema.messages.types import JOINT_STATE, schema_text, type_hash


def test_joint_state_key_is_the_one_rmw_zenoh_uses():
    # Literal on purpose: with another hash no ROS 2 node would see us, and nothing would tell.
    key = (
        "0/joint_states/sensor_msgs::msg::dds_::JointState_/"
        "RIHS01_a13ee3a330e346c9d87b5aa18d24e11690752bd33a0350f11c5882bc9179260e"
    )
    assert JOINT_STATES.key_expression(0) == key
    assert JOINT_COMMANDS.key_expression(42) == "42" + key[1:].replace("states", "commands")


def test_names_and_keys_are_unique():
    assert len({topic.name for topic in TOPICS}) == len(TOPICS)
    assert len({topic.key_expression(0) for topic in TOPICS}) == len(TOPICS)


@pytest.mark.parametrize("topic", TOPICS, ids=lambda topic: topic.name)
def test_keys_have_the_four_parts_of_rmw_zenoh(topic):
    pattern = r"7/[a-z_]+/[a-z_]+::msg::dds_::[A-Za-z]+_/RIHS01_[0-9a-f]{64}"
    assert re.fullmatch(pattern, topic.key_expression(7))


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
