"""rmw_zenoh's additions to messages: the attachment, and the tokens of the ROS graph.

Formats after rmw_zenoh_cpp's design document (sections "Topics" and "Graph Cache").
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from enum import StrEnum
from typing import NamedTuple

import xxhash

from bus_schema.messages.topics import JOINT_COMMANDS, TOPICS, Role, Topic
from bus_schema.messages.types import type_hash

GID_BYTES = 16
ATTACHMENT = struct.Struct(f"<qqB{GID_BYTES}s")
"""Wire format of an `Attachment`; the length of the identifier precedes it."""
_ADMIN = "@ros2_lv"
_FIELDS_BEFORE_NODE_NAME = 8
_MOST_SENDERS, _MOST_PUBLISHERS = 1000, 10_000


class Attachment(NamedTuple):
    """Metadata that accompanies every payload.

    Attributes:
        sequence: number of the message on its topic, from 1.
        source_time_ns: time of sending, Unix time.
        gid: identifier of the sending publisher, 16 bytes.
    """

    sequence: int
    source_time_ns: int
    gid: bytes

    def encode(self) -> bytes:
        return ATTACHMENT.pack(self.sequence, self.source_time_ns, GID_BYTES, self.gid)

    @staticmethod
    def decode(data: bytes) -> Attachment | None:
        """Decode an attachment; None if these bytes are none. As in rmw_zenoh, more may follow."""
        if len(data) < ATTACHMENT.size:
            return None
        sequence, source_time_ns, gid_bytes, gid = ATTACHMENT.unpack_from(data)
        if gid_bytes != GID_BYTES or sequence < 0 or source_time_ns < 0:
            return None
        return Attachment(sequence, source_time_ns, gid)


def beside(data: bytes) -> bytes | None:
    """Return the bytes after an attachment (a joint state's plant status); None without any."""
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
        """Return the entity that a liveliness token announces; None if it is no such token."""
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
    """Key expression of all tokens of one of our own nodes, in any session."""
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


class RosGraph:
    """Members of a ROS domain by their liveliness tokens, and which senders have left.

    An id that rmw_zenoh made from a token identifies that token's publisher. Other ids are
    arbitrary: their sender is one of the publishers of commands that were on the bus at its first
    command, and has left once all of those have.

    Args:
        own_session: identifier of this process's session.

    Attributes:
        announced: sessions that ever announced a token.
        sessions: session of each publisher by its id, also of those that left; their number is
            limited, so that forged publishers cannot fill the memory.
    """

    def __init__(self, own_session: str) -> None:
        self._own_session = own_session
        self._entities: dict[str, Entity] = {}  # by token
        self._publishers: set[bytes] = set()  # ids
        self._commanders: set[str] = set()  # tokens
        self._offered: set[str] = set()  # topics of which others ever announced publishers
        self._companions: dict[bytes, set[str]] = {}  # commanders at a sender's first command
        self.announced: set[str] = set()
        self.sessions: dict[bytes, str] = {}

    def change(self, token: str, alive: bool) -> Entity | None:
        """Add or remove a token; return its entity, or None for a token of no entity."""
        entity = Entity.from_token(token)
        if entity is None:
            return None
        if alive:
            self._entities[token] = entity
            self.announced.add(entity.session)
        else:
            self._entities.pop(token, None)
        if entity.kind == EntityKind.PUBLISHER:
            self._change_publisher(token, entity, alive)
        return entity

    def others(self, kind: EntityKind) -> list[Entity]:
        """Return the entities of this kind that other sessions have announced."""
        known = list(self._entities.values())
        return [each for each in known if each.session != self._own_session and each.kind == kind]

    def has_publisher(self, topic: Topic) -> bool:
        """Whether another session has announced that it sends on a topic."""
        return any(entity.topic == topic.name for entity in self.others(EntityKind.PUBLISHER))

    def publishers_have_left(self, topic: Topic) -> bool:
        """Whether other sessions had publishers of a topic, and none is left."""
        return topic.name in self._offered and not self.has_publisher(topic)

    def sessions_of(self, role: Role) -> set[str]:
        """Return the other sessions with an entity in the name of one of our own processes."""
        known = list(self._entities.values())
        return {each.session for each in known if each.node == node_name(role)} - {
            self._own_session
        }

    def speakers(self) -> set[str]:
        """Return the sessions that have announced publishers of our topics."""
        names = {topic.name for topic in TOPICS}
        others = self.others(EntityKind.PUBLISHER)
        return {entity.session for entity in others if entity.topic in names}

    def knows_all(self, sessions: set[str]) -> bool:
        """Whether each of these sessions still has an announced entity."""
        return sessions <= {entity.session for entity in list(self._entities.values())}

    def note_command(self, sender: bytes) -> None:
        """Note a command from `sender`; b"" is any sender without an id, so each may be a new one.

        Without a known publisher of commands, nothing is noted: it may still announce itself.
        """
        is_new = not sender or sender not in self._companions
        if is_new and self._commanders and len(self._companions) < _MOST_SENDERS:
            self._companions[sender] = set(self._commanders)

    def has_left(self, sender: bytes) -> bool:
        """Whether a sender was announced and has left."""
        if sender in self._publishers:
            return False
        companions = self._companions.get(sender)
        all_left = companions is not None and companions.isdisjoint(self._commanders)
        return sender in self.sessions or all_left

    def _change_publisher(self, token: str, entity: Entity, alive: bool) -> None:
        gid = endpoint_gid(token)
        if not alive:
            self._publishers.discard(gid)
            self._commanders.discard(token)
            return
        self._publishers.add(gid)
        self.sessions[gid] = entity.session
        if len(self.sessions) > _MOST_PUBLISHERS:
            del self.sessions[next(iter(self.sessions))]
        if entity.session != self._own_session:
            self._offered.add(entity.topic)
        if entity.topic == JOINT_COMMANDS.name:
            self._commanders.add(token)
