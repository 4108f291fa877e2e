"""Messages in bundles: what loops send, as a recorder takes it.

A recorder that subscribes to what loops send at every tick is a second peer to each `put`, and a
thread that is woken up each time, beside loops that wait for one another. So loops put all they
send into bundles too, and tell so by a token. Commands are told of by the plant, as it
takes them in, whoever sent them and whatever becomes of him. While nobody else has announced that
he speaks, a recorder takes bundles alone. Whoever subscribes to topics gets each message at once.

Bundles are numbered, and a loop keeps its newest: a connection may not be up yet when the first is
sent, or fail later, and a recorder asks for what it lacks.
"""

from __future__ import annotations

import struct
import threading
import time
from collections import deque
from collections.abc import Mapping
from typing import NamedTuple

from bus_schema.messages.topics import JOINT_COMMANDS, Role, Topic, topics_of
from bus_schema.zenoh.access import (
    bundle_key_expression,
    bundling_key_expression,
    missed_key_expression,
)
from bus_schema.zenoh.ros_graph import ATTACHMENT, GID_BYTES, Attachment, endpoint_gid
from bus_schema.zenoh.session import MAX_MESSAGE_BYTES, Delivery, ZenohPublisher, ZenohSession

_FULL_BYTES = 1 << 16
_MOST_MESSAGES = 256
MOST_KEPT = 512
_KEPT_BYTES = 1 << 22
"""Of a plant at 1 kHz some three seconds, of a controller ten: a connection is up again by then."""
_LARGEST_KEPT_BYTES = MAX_MESSAGE_BYTES // 2
_MOST_ANSWERED_PER_S = 50
"""Requests for bundles, whoever sends them: all that are kept in under three seconds."""
MOST_AT_ONCE = 4
"""Bundles that are sent again at once: more would fill a loop's queue to a recorder."""
HEAD = struct.Struct("<BII")  # bytes of topic, attachment and payload, which follow
_SPAN = struct.Struct(f"<QQ{GID_BYTES}s")
BUNDLED = {
    Role.PLANT: [*topics_of(Role.PLANT), JOINT_COMMANDS],
    Role.CONTROLLER: [topic for topic in topics_of(Role.CONTROLLER) if topic is not JOINT_COMMANDS],
}
"""What the bundles of each loop hold; nobody says more in another's name."""
Received = tuple[Topic, bytes, int, int, bytes]
"""A message as a recorder takes it: topic, payload, and what its attachment says of it: number,
when it was sent (Unix time, ns) and id of its sender; `UNKNOWN` where it has none."""
UNKNOWN = Attachment(0, 0, b"")


class Span(NamedTuple):
    """Numbers of bundles: beside a bundle, of those that can be had up to itself; or those missed.

    Attributes:
        first: the first of them, from 1.
        last: the last of them.
        sender: identifies who sends them, 16 bytes.
    """

    first: int
    last: int
    sender: bytes

    def encode(self) -> bytes:
        return _SPAN.pack(*self)

    @staticmethod
    def decode(data: bytes) -> Span | None:
        """The span, or None if these bytes are none."""
        if len(data) != _SPAN.size:
            return None
        span = Span(*_SPAN.unpack(data))
        return span if 1 <= span.first <= span.last < span.first + MOST_KEPT else None


class Bundler:
    """Sends bundles.

    Args:
        session: of the loop.
        domain: ROS domain.
        role: which loop it is.

    Attributes:
        topics: what is to be added; to the plant's, commands as it takes them in.
    """

    def __init__(self, session: ZenohSession, domain: int, role: Role) -> None:
        token = bundling_key_expression(domain, role, session.identifier)
        self.topics = BUNDLED[role]
        self._sender = endpoint_gid(token)
        self._publisher: ZenohPublisher = session.publisher(bundle_key_expression(domain, role))
        self._waiting: deque[bytes] = deque()
        self._kept: deque[bytes] = deque()
        self._last = self._kept_bytes = 0  # number of the newest bundle; size of those kept
        self._answered, self._answering_since_s = 0, 0.0
        self._lock = threading.Lock()
        session.subscribe(missed_key_expression(domain), self._on_missed)
        session.announce(token)

    def add(self, topic: bytes, attachment: bytes, payload: bytes) -> None:
        """Add a message; those that are many or large enough are sent."""
        head = HEAD.pack(len(topic), len(attachment), len(payload))
        self._waiting.append(head + topic + attachment + payload)
        if len(self._waiting) >= _MOST_MESSAGES or len(payload) >= _FULL_BYTES:
            self.send()

    def send(self) -> None:
        """Send what was added since the last bundle, in more than one if it is much.

        A message that is too large for the transport takes no others along.
        """
        with self._lock:
            bundle: list[bytes] = []
            size = 0
            for _ in range(len(self._waiting)):  # in a flood there are always more
                message = self._waiting.popleft()
                size += len(message)
                if bundle and size > _FULL_BYTES:
                    self._send(b"".join(bundle))
                    bundle, size = [], len(message)
                bundle.append(message)
            if bundle:
                self._send(b"".join(bundle))

    def tell(self) -> None:
        """Tell how many bundles there are, to recorders that may lack the last ones."""
        with self._lock:
            if self._last:
                self._publisher.put(b"", self._span(self._last))

    def _send(self, bundle: bytes) -> None:
        if len(bundle) > _LARGEST_KEPT_BYTES:  # nobody is to wait for what may never pass
            self._publisher.put(bundle, b"")
            return
        self._last += 1
        self._kept.append(bundle)
        self._kept_bytes += len(bundle)
        while self._kept_bytes > _KEPT_BYTES or len(self._kept) > MOST_KEPT:
            self._kept_bytes -= len(self._kept.popleft())
        self._publisher.put(bundle, self._span(self._last))

    def _span(self, number: int) -> bytes:
        return _SPAN.pack(self._first, number, self._sender)

    @property
    def _first(self) -> int:
        """Number of the oldest bundle that is kept."""
        return self._last - len(self._kept) + 1

    def _on_missed(self, delivery: Delivery) -> None:
        """Send again what a recorder lacks, some of it; the loop is not to wait for that."""
        missed = Span.decode(delivery.payload)
        if missed is None or missed.sender != self._sender or not self._may_answer():
            return
        with self._lock:
            first = max(missed.first, self._first)
            end = min(missed.last + 1, self._last + 1, first + MOST_AT_ONCE)
            again = [
                (self._kept[number - self._first], self._span(number))
                for number in range(first, end)
            ]
        for bundle, span in again:
            self._publisher.put(bundle, span)

    def _may_answer(self) -> bool:
        """Whether so few requests came lately that this one is no flood: a recorder asks again."""
        now_s = time.monotonic()
        if now_s - self._answering_since_s >= 1.0:
            self._answered, self._answering_since_s = 0, now_s
        self._answered += 1
        return self._answered <= _MOST_ANSWERED_PER_S


def unbundled(bundle: bytes, topics: Mapping[bytes, Topic]) -> list[Received]:
    """The messages in a bundle on these topics, by their names; what is no message ends it.

    Recorders spend their time here: one loop, which reads attachments as `Attachment.decode` does.
    """
    messages = []
    at, end, head_bytes, numbers_bytes = 0, len(bundle), HEAD.size, ATTACHMENT.size
    while at + head_bytes <= end:
        name_bytes, attachment_bytes, payload_bytes = HEAD.unpack_from(bundle, at)
        name_at = at + head_bytes
        attachment_at = name_at + name_bytes
        payload_at = attachment_at + attachment_bytes
        at = payload_at + payload_bytes
        topic = topics.get(bundle[name_at:attachment_at])
        if at > end or topic is None:
            continue
        sequence, source_time_ns, gid_bytes, gid = 0, 0, 0, b""
        if attachment_bytes >= numbers_bytes:
            sequence, source_time_ns, gid_bytes, gid = ATTACHMENT.unpack_from(bundle, attachment_at)
        if gid_bytes != GID_BYTES or sequence < 0 or source_time_ns < 0:
            sequence, source_time_ns, gid = UNKNOWN
        messages.append((topic, bundle[payload_at:at], sequence, source_time_ns, gid))
    return messages
