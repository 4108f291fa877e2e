"""A sender of commands that has left is known as gone, whatever made its id."""

from __future__ import annotations

import pytest

from bus_schema.messages.topics import JOINT_COMMANDS, JOINT_STATES
from bus_schema.zenoh.ros_graph import Entity, EntityKind, Senders, endpoint_gid, endpoint_token

ANY_ID = b"made at random.."


def token(session: str, topic=JOINT_COMMANDS) -> str:
    return endpoint_token(0, session, "somebody", 1, EntityKind.PUBLISHER, topic)


FIRST, SECOND = token("a1"), token("b2")


def come(senders: Senders, *tokens: str) -> None:
    for each in tokens:
        entity = Entity.from_token(each)
        assert entity is not None
        senders.come(each, entity)


@pytest.fixture
def senders() -> Senders:
    return Senders()


def test_id_made_of_a_token_is_gone_with_it_though_others_stay(senders: Senders) -> None:
    come(senders, FIRST, SECOND)
    senders.note(endpoint_gid(FIRST))
    assert not senders.has_left(endpoint_gid(FIRST))
    senders.leave(FIRST)
    assert senders.has_left(endpoint_gid(FIRST))
    assert not senders.has_left(endpoint_gid(SECOND))


@pytest.mark.parametrize("sender", [ANY_ID, b""], ids=["any id", "no id"])
def test_other_id_is_gone_once_all_that_were_there_with_it_are(
    senders: Senders, sender: bytes
) -> None:
    come(senders, FIRST)
    senders.note(sender)
    come(senders, SECOND)  # a successor that waits
    assert not senders.has_left(sender)
    senders.leave(FIRST)
    assert senders.has_left(sender)


def test_either_of_two_may_be_the_sender(senders: Senders) -> None:
    come(senders, FIRST, SECOND)
    senders.note(ANY_ID)
    senders.leave(FIRST)
    assert not senders.has_left(ANY_ID)
    senders.leave(SECOND)
    assert senders.has_left(ANY_ID)


def test_sender_that_announces_itself_after_its_first_command(senders: Senders) -> None:
    senders.note(ANY_ID)
    come(senders, FIRST)
    senders.note(ANY_ID)
    senders.leave(FIRST)
    assert senders.has_left(ANY_ID)


def test_sender_that_never_announced_itself_never_leaves(senders: Senders) -> None:
    come(senders, token("a1", JOINT_STATES))
    senders.note(ANY_ID)
    senders.leave(token("a1", JOINT_STATES))
    assert not senders.has_left(ANY_ID)


def test_sender_without_an_id_that_came_again_is_there(senders: Senders) -> None:
    come(senders, FIRST)
    senders.note(b"")
    senders.leave(FIRST)
    come(senders, SECOND)
    senders.note(b"")
    assert not senders.has_left(b"")
