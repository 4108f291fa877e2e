"""The bytes and tokens beside a message, against literals worked out from rmw_zenoh's design.

The examples there: ``@ros2_lv/2/aac3…/0/0/NN/%/%/listener`` for a node and
``@ros2_lv/2/aac3…/0/10/MS/%/%/listener/%chatter/std_msgs::msg::dds_::String_/RIHS01_…/::,10:,:,:,,``
for an endpoint of it; the attachment is int64 number, int64 time, length of the id, id.
"""

from __future__ import annotations

import pytest

from bus_schema.messages.topics import JOINT_COMMANDS, JOINT_STATES
from bus_schema.zenoh.ros_graph import (
    Attachment,
    Entity,
    EntityKind,
    beside,
    endpoint_gid,
    endpoint_token,
    node_token,
)

GID = bytes(range(16))
SESSION = "aac3178e146ba6f1fc6e6a4085e77f21"
JOINT_STATE_HASH = "RIHS01_a13ee3a330e346c9d87b5aa18d24e11690752bd33a0350f11c5882bc9179260e"
NODE = f"@ros2_lv/7/{SESSION}/0/0/NN/%/%/funnel_hil_plant"
PUBLISHER = (
    f"@ros2_lv/7/{SESSION}/0/3/MP/%/%/funnel_hil_plant/%joint_states"
    f"/sensor_msgs::msg::dds_::JointState_/{JOINT_STATE_HASH}/::,10:,:,:,,"
)
SUBSCRIBER = (
    f"@ros2_lv/7/{SESSION}/0/4/MS/%/%/funnel_hil_plant/%joint_commands"
    f"/sensor_msgs::msg::dds_::JointState_/{JOINT_STATE_HASH}/::,10:,:,:,,"
)
CHATTER = (
    "@ros2_lv/2/8b20917502ee955ac4476e0266340d5c/0/10/MP/%/%/talker/%chatter"
    "/std_msgs::msg::dds_::String_"
    "/RIHS01_df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18/::,7:,:,:,,"
)


def test_attachment_is_33_bytes_little_endian() -> None:
    encoded = Attachment(sequence=0x0102, source_time_ns=0x1122334455667788, gid=GID).encode()
    assert encoded == bytes.fromhex(
        "0201000000000000"  # number
        "8877665544332211"  # Unix time, ns
        "10"  # 16 bytes of id follow
        "000102030405060708090a0b0c0d0e0f"
    )
    assert len(encoded) == 33


def test_what_follows_an_attachment_is_no_part_of_it() -> None:
    attachment = Attachment(1, 2, GID)
    assert Attachment.decode(attachment.encode() + b"more") == attachment
    assert beside(attachment.encode() + b"more") == b"more"
    assert beside(attachment.encode()) is None
    assert beside(b'{"from": "another attachment"}') is None


@pytest.mark.parametrize(
    "data",
    [
        b"",
        Attachment(1, 2, GID).encode()[:-1],
        bytes(8) + bytes(8) + b"\x0f" + GID,  # another length of the id
        b"\xff" * 8 + bytes(8) + b"\x10" + GID,  # number −1
    ],
    ids=["empty", "short", "id of 15", "negative"],
)
def test_bytes_that_are_no_attachment_are_none(data: bytes) -> None:
    assert Attachment.decode(data) is None


def test_node_token() -> None:
    assert node_token(7, SESSION, "funnel_hil_plant") == NODE


def test_endpoint_tokens() -> None:
    node = (7, SESSION, "funnel_hil_plant")
    assert endpoint_token(*node, 3, EntityKind.PUBLISHER, JOINT_STATES) == PUBLISHER
    assert endpoint_token(*node, 4, EntityKind.SUBSCRIBER, JOINT_COMMANDS) == SUBSCRIBER


@pytest.mark.parametrize(
    ("token", "entity"),
    [
        (NODE, Entity(SESSION, "NN", "funnel_hil_plant", "")),
        (PUBLISHER, Entity(SESSION, "MP", "funnel_hil_plant", "joint_states")),
        (SUBSCRIBER, Entity(SESSION, "MS", "funnel_hil_plant", "joint_commands")),
        (CHATTER, Entity("8b20917502ee955ac4476e0266340d5c", "MP", "talker", "chatter")),
    ],
    ids=["node", "publisher", "subscriber", "foreign publisher"],
)
def test_tokens_are_read_back(token: str, entity: Entity) -> None:
    assert Entity.from_token(token) == entity


@pytest.mark.parametrize(
    "token", ["", "@ros2_lv", "@ros2_lv/7/**", "7/joint_states/x/y", "a/" * 20]
)
def test_other_keys_are_no_tokens(token: str) -> None:
    assert Entity.from_token(token) is None


def test_id_of_an_endpoint_is_the_one_that_rmw_zenoh_gives_it() -> None:
    """Literals from rmw_zenoh_cpp's own `simplified_XXH3_128bits`, compiled and run."""
    assert endpoint_gid(CHATTER).hex() == "ac170f31eadcd9ff0cd86d7a17907d1c"
    assert endpoint_gid(PUBLISHER).hex() == "2fa2e7891bb65e16ab3f39f8aa0852a4"
