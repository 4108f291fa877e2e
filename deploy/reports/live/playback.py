"""A recorded run as a source of snapshots, at its original speed or another one."""

from __future__ import annotations

import heapq
import time
from collections.abc import Callable, Iterator, Mapping, Sequence

from bus_schema.messages import topics
from bus_schema.messages.types import stamp_of
from deploy.run.network.snapshot import Message, Sampler, Snapshot

_LOOK_S = 0.02
"""Time between two snapshots, as for a recorder."""


class Playback:
    """Plays the messages of a recording once a viewer is open.

    Args:
        payloads: messages by topic, in order.
        joint_names: the robot's joints.
        speed: speed relative to the original.
        is_watched: whether a viewer is open; the playback waits for one.

    Attributes:
        is_over: everything was shown.
    """

    def __init__(
        self,
        payloads: Mapping[str, Sequence[bytes]],
        joint_names: tuple[str, ...],
        speed: float,
        is_watched: Callable[[], bool],
    ) -> None:
        self._messages = in_order(payloads)
        self._next = next(self._messages, None)
        self._sampler = Sampler(joint_names)
        self._speed, self._is_watched = speed, is_watched
        self._began_s: float | None = None
        self._due_s = 0.0

    @property
    def is_over(self) -> bool:
        return self._next is None

    def receive(self, timeout_s: float) -> Snapshot | None:
        """Return the next snapshot when its time has come; None if there is nothing to show yet."""
        if self._next is None or not (self._began_s is not None or self._is_watched()):
            time.sleep(timeout_s)
            return None
        if self._began_s is None:
            self._began_s = self._due_s = time.monotonic()
        self._due_s += _LOOK_S
        time.sleep(max(0.0, self._due_s - time.monotonic()))
        until_ns = (self._due_s - self._began_s) * self._speed * 1e9
        while self._next is not None and self._next.stamp_ns <= until_ns:
            self._sampler.take(self._next)
            self._next = next(self._messages, None)
        return self._sampler.snapshot()

    def close(self) -> None:
        """Do nothing: nothing is open."""


def in_order(payloads: Mapping[str, Sequence[bytes]]) -> Iterator[Message]:
    """Return all messages of a recording by their stamps; those without a stamp come first."""

    def of(topic: topics.Topic) -> Iterator[Message]:
        last_ns = 0
        for payload in payloads.get(topic.name, ()):
            stamp_ns = stamp_of(payload)
            last_ns = max(last_ns, 0 if stamp_ns is None else stamp_ns)
            yield Message(topic, last_ns, payload)

    return heapq.merge(*map(of, topics.TOPICS), key=lambda message: message.stamp_ns)
