"""A sender of commands that has left is known to be gone, for any kind of id."""

from __future__ import annotations

import pytest

from bus_schema.messages.topics import JOINT_COMMANDS, JOINT_STATES
from bus_schema.zenoh.ros_graph import EntityKind, RosGraph, endpoint_gid, endpoint_token

ANY_ID = b"made at random.."


def token(session: str, topic=JOINT_COMMANDS) -> str:
    return endpoint_token(0, session, "somebody", 1, EntityKind.PUBLISHER, topic)


FIRST, SECOND = token("a1"), token("b2")


def come(graph: RosGraph, *tokens: str) -> None:
    for each in tokens:
        graph.change(each, alive=True)


def leave(graph: RosGraph, token: str) -> None:
    graph.change(token, alive=False)


@pytest.fixture
def graph() -> RosGraph:
    return RosGraph("own")


def test_id_made_of_a_token_is_gone_with_it_though_others_stay(graph: RosGraph) -> None:
    come(graph, FIRST, SECOND)
    graph.note_command(endpoint_gid(FIRST))
    assert not graph.has_left(endpoint_gid(FIRST))
    leave(graph, FIRST)
    assert graph.has_left(endpoint_gid(FIRST))
    assert not graph.has_left(endpoint_gid(SECOND))


@pytest.mark.parametrize("sender", [ANY_ID, b""], ids=["any id", "no id"])
def test_other_id_is_gone_once_all_that_were_there_with_it_are(graph, sender):
    come(graph, FIRST)
    graph.note_command(sender)
    come(graph, SECOND)  # a successor that waits
    assert not graph.has_left(sender)
    leave(graph, FIRST)
    assert graph.has_left(sender)


def test_either_of_two_may_be_the_sender(graph: RosGraph) -> None:
    come(graph, FIRST, SECOND)
    graph.note_command(ANY_ID)
    leave(graph, FIRST)
    assert not graph.has_left(ANY_ID)
    leave(graph, SECOND)
    assert graph.has_left(ANY_ID)


def test_sender_that_announces_itself_after_its_first_command(graph: RosGraph) -> None:
    graph.note_command(ANY_ID)
    come(graph, FIRST)
    graph.note_command(ANY_ID)
    leave(graph, FIRST)
    assert graph.has_left(ANY_ID)


def test_sender_that_never_announced_itself_never_leaves(graph: RosGraph) -> None:
    come(graph, token("a1", JOINT_STATES))
    graph.note_command(ANY_ID)
    leave(graph, token("a1", JOINT_STATES))
    assert not graph.has_left(ANY_ID)


def test_sender_without_an_id_that_came_again_is_there(graph: RosGraph) -> None:
    come(graph, FIRST)
    graph.note_command(b"")
    leave(graph, FIRST)
    come(graph, SECOND)
    graph.note_command(b"")
    assert not graph.has_left(b"")
