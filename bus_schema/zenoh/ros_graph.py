"""What rmw_zenoh puts around a message: the attachment, and the tokens that make up the ROS graph.

Formats after rmw_zenoh_cpp's design document (sections "Topics" and "Graph Cache").
"""

from __future__ import annotations

import struct
from collections import deque
from dataclasses import dataclass
from enum import StrEnum
from typing import NamedTuple

import xxhash

from bus_schema.messages.topics import JOINT_COMMANDS, Role, Topic
from bus_schema.messages.types import type_hash

GID_BYTES = 16
ATTACHMENT = struct.Struct(f"<qqB{GID_BYTES}s")
"""What an `Attachment` is on the wire; before its identifier stands how many bytes that has."""
_ADMIN = "@ros2_lv"
_FIELDS_BEFORE_NODE_NAME = 8
_REMEMBERED = 1000


class Attachment(NamedTuple):
    """Travels beside every payload.

    Attributes:
        sequence: number of the message on its topic, from 1.
        source_time_ns: when it was sent, Unix time.
        gid: identifier of the sending publisher, 16 bytes.
    """

    sequence: int
    source_time_ns: int
    gid: bytes

    def encode(self) -> bytes:
        return ATTACHMENT.pack(self.sequence, self.source_time_ns, GID_BYTES, self.gid)

    @staticmethod
    def decode(data: bytes) -> Attachment | None:
        """The attachment, or None if these bytes are none. As in rmw_zenoh, more may follow."""
        if len(data) < ATTACHMENT.size:
            return None
        sequence, source_time_ns, gid_bytes, gid = ATTACHMENT.unpack_from(data)
        if gid_bytes != GID_BYTES or sequence < 0 or source_time_ns < 0:
            return None
        return Attachment(sequence, source_time_ns, gid)


def beside(data: bytes) -> bytes | None:
    """What follows an attachment, with a joint state its plant status; None if nothing does."""
    if len(data) > ATTACHMENT.size and Attachment.decode(data) is not None:
        return data[ATTACHMENT.size :]
    return None


class EntityKind(StrEnum):
    """Kinds of entities in the ROS graph."""

    NODE = "NN"
    PUBLISHER = "MP"
    SUBSCRIBER = "MS"


@dataclass(frozen=True)
class Entity:
    """An entity in the ROS graph, as its liveliness token describes it.

    Attributes:
        session: Zenoh identifier of the session it lives in.
        kind: an `EntityKind`, or a foreign kind.
        node: name of its node.
        topic: name of its topic without slashes; empty for nodes.
    """

    session: str
    kind: str
    node: str
    topic: str

    @staticmethod
    def from_token(token: str) -> Entity | None:
        """The entity that a liveliness token announces, or None if it is no such token."""
        parts = token.split("/")
        if parts[0] != _ADMIN or len(parts) <= _FIELDS_BEFORE_NODE_NAME:
            return None
        topic = parts[9].strip("%") if len(parts) > 9 else ""
        return Entity(session=parts[2], kind=parts[5], node=parts[8], topic=topic)


def graph_key_expression(domain: int) -> str:
    """Key expression of all tokens of a ROS domain."""
    return f"{_ADMIN}/{domain}/**"


def node_name(role: Role) -> str:
    """Name of one of our own nodes."""
    return f"funnel_hil_{role}"


def node_tokens(domain: int, role: Role) -> str:
    """Key expression of all tokens of one of our own nodes, in whatever session."""
    return f"{_ADMIN}/{domain}/*/*/*/*/*/*/{node_name(role)}/**"


def node_token(domain: int, session: str, node: str) -> str:
    """Token of a node."""
    return f"{_ADMIN}/{domain}/{session}/0/0/{EntityKind.NODE}/%/%/{node}"


def endpoint_token(
    domain: int, session: str, node: str, entity_id: int, kind: EntityKind, topic: Topic
) -> str:
    """Token of a publisher or subscriber."""
    return (
        f"{_ADMIN}/{domain}/{session}/0/{entity_id}/{kind}/%/%/{node}"
        f"/%{topic.name}/{topic.dds_type}/{type_hash(topic.type_name)}/{topic.qos}"
    )


def endpoint_gid(token: str) -> bytes:
    """Identifier of an endpoint, from its token: XXH3-128, low half first, as in rmw_zenoh."""
    return xxhash.xxh3_128_intdigest(token.encode()).to_bytes(GID_BYTES, "little")


class Senders:
    """Follows publishers by their tokens, and senders of commands that no token gives the id of.

    An id made from a token, as rmw_zenoh makes it, is known by that token. Other ids are any bytes:
    their sender is one of the publishers that were on the bus when it was first heard, and is gone
    once all of those are.
    """

    def __init__(self) -> None:
        self._publishers: dict[str, bytes] = {}  # ids by token
        self._commanders: set[str] = set()  # tokens
        self._departed: deque[bytes] = deque(maxlen=_REMEMBERED)
        self._companions: dict[bytes, set[str]] = {}

    def come(self, token: str, entity: Entity) -> None:
        """A token was announced."""
        if entity.kind == EntityKind.PUBLISHER:
            self._publishers[token] = endpoint_gid(token)
            if entity.topic == JOINT_COMMANDS.name:
                self._commanders.add(token)

    def leave(self, token: str) -> None:
        """A token is gone."""
        self._commanders.discard(token)
        gid = self._publishers.pop(token, None)
        if gid is not None:
            self._departed.append(gid)

    def note(self, sender: bytes) -> None:
        """A command came from `sender`; b"" is whoever gives no id, and may come again as another.

        Until a publisher of commands is known, it may still be about to announce itself.
        """
        is_new = not sender or sender not in self._companions
        if is_new and self._commanders and len(self._companions) < _REMEMBERED:
            self._companions[sender] = set(self._commanders)

    def has_left(self, sender: bytes) -> bool:
        """Whether a sender was announced, and is gone."""
        if sender in self._departed:
            return True
        if sender in self._publishers.values():
            return False
        companions = self._companions.get(sender)
        return companions is not None and companions.isdisjoint(self._commanders)
