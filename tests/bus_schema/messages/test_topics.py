import re

import pytest

from bus_schema.messages.topics import JOINT_COMMANDS, JOINT_STATES, TOPICS


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
