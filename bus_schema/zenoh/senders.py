"""Who of those that send commands is still on the bus, whatever made the ids of their messages."""

from __future__ import annotations

from collections import deque

from bus_schema.messages import topics
from bus_schema.zenoh.ros_graph import Entity, EntityKind, endpoint_gid

_REMEMBERED = 1000


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
            if entity.topic == topics.JOINT_COMMANDS.name:
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
