"""Snapshots of a run for viewers: the newest message of each topic, some times a second."""

from __future__ import annotations

import struct
from collections.abc import Mapping
from typing import Any, NamedTuple

from bus_schema.messages import topics
from bus_schema.messages.topics import Rate, Topic

_LATENESS = struct.Struct("<q")
"""Negative where a tick was skipped."""
_COUNTS = struct.Struct("<QQ")
_HEAD = struct.Struct("<BqI")
_MOST_EVENTS = 100


class Message(NamedTuple):
    """One message of the bus.

    Attributes:
        stamp_ns: on the run's clock.
        payload: its CDR bytes, as received.
    """

    topic: Topic
    stamp_ns: int
    payload: bytes


class Snapshot(NamedTuple):
    """A snapshot of a run.

    Attributes:
        ticks: number of the plant's ticks that are known to have ended.
        deadlines_missed: how many of them missed their deadline or were skipped.
        messages: the newest message of each topic since the last snapshot, and all events.
    """

    ticks: int
    deadlines_missed: int
    messages: tuple[Message, ...]

    def encode(self) -> bytes:
        """Return the bytes of a datagram."""
        parts = [_COUNTS.pack(self.ticks, self.deadlines_missed)]
        for topic, stamp_ns, payload in self.messages:
            parts += [_HEAD.pack(topics.TOPICS.index(topic), stamp_ns, len(payload)), payload]
        return b"".join(parts)

    @staticmethod
    def decode(datagram: bytes) -> Snapshot:
        """Read the bytes of a datagram.

        Raises:
            ValueError: they are no snapshot.
        """
        messages = []
        try:
            ticks, missed = _COUNTS.unpack_from(datagram)
            position = _COUNTS.size
            while position < len(datagram):
                index, stamp_ns, size = _HEAD.unpack_from(datagram, position)
                position += _HEAD.size
                payload = datagram[position : position + size]
                if len(payload) < size:
                    raise ValueError("a message is cut off")
                messages.append(Message(topics.TOPICS[index], stamp_ns, payload))
                position += size
        except (struct.error, IndexError) as error:
            raise ValueError(f"not a snapshot of a run: {error}") from error
        return Snapshot(ticks, missed, tuple(messages))


class Sampler:
    """Selects the messages for viewers, and counts deadlines at each message.

    Args:
        joint_names: the robot's joints, which determine the length of a message.
    """

    def __init__(self, joint_names: tuple[str, ...]) -> None:
        truth = topics.layout(topics.PLANT_TRUTH, joint_names)
        self._truth_bytes = truth.size
        places: Mapping[str, Any] = truth.dtype.fields or {}
        self._deadline_met_at = places["deadline_met"][1]
        self._lateness_at = places["timing.lateness_ns"][1]
        self._truths = self._missed = 0
        self._newest: dict[str, Message] = {}
        self._events: list[Message] = []

    def take(self, message: Message) -> None:
        """Take a message."""
        topic, _, payload = message
        if topic.rate is Rate.EVENT:
            self._events.append(message)
            del self._events[:-_MOST_EVENTS]
            return
        self._newest[topic.name] = message
        if topic is topics.PLANT_TRUTH and len(payload) == self._truth_bytes:
            self._truths += 1
            (lateness_ns,) = _LATENESS.unpack_from(payload, self._lateness_at)
            self._missed += lateness_ns < 0 or not payload[self._deadline_met_at]

    def snapshot(self) -> Snapshot | None:
        """Return everything new since the last call; None if nothing is."""
        messages = (*self._newest.values(), *self._events)
        self._newest, self._events = {}, []
        ticks = max(0, self._truths - 1)  # a tick's first message reports its beginning
        return Snapshot(ticks, self._missed, messages) if messages else None
