"""Bundles of messages that loops send to recorders.

A recorder that subscribes to the topics of every tick costs each `put` a second peer, and wakes a
thread each time, while the loops wait for each other. So loops also put all their messages into
bundles, and announce this by a token. The plant bundles commands as it receives them, those of
other senders than the commander as `REJECTED_COMMANDS`. While no other sender has announced itself,
a recorder takes only bundles. Subscribers to topics still get each message at once.

Bundles are numbered, and a loop keeps its newest: a recorder whose connection was late or failed
requests the missing ones.
"""

from __future__ import annotations

import struct
import threading
import time
from collections import deque
from collections.abc import Mapping
from typing import NamedTuple

from bus_schema.messages.topics import JOINT_COMMANDS, REJECTED_COMMANDS, Role, Topic, topics_of
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
"""Three seconds of a plant at 1 kHz, ten of a controller: time for a connection to be restored."""
_LARGEST_KEPT_BYTES = MAX_MESSAGE_BYTES // 2
_MOST_ANSWERED_PER_S = 50
"""Answered requests for bundles, from all senders: all kept bundles in under three seconds."""
MOST_AT_ONCE = 4
"""Bundles sent again at once: more would fill a loop's queue to a recorder."""
HEAD = struct.Struct("<BII")  # bytes of topic, attachment and payload, which follow
_SPAN = struct.Struct(f"<QQ{GID_BYTES}s")
BUNDLED = {
    Role.PLANT: [*topics_of(Role.PLANT), JOINT_COMMANDS, REJECTED_COMMANDS],
    Role.CONTROLLER: [topic for topic in topics_of(Role.CONTROLLER) if topic is not JOINT_COMMANDS],
}
"""Topics in the bundles of each loop; no other role may send them in its name."""
Received = tuple[Topic, bytes, int, int, bytes]
"""Topic, payload, and from the attachment: number, Unix time (ns), sender's id; or `UNKNOWN`."""
UNKNOWN = Attachment(0, 0, b"")


class Span(NamedTuple):
    """Range of bundle numbers: beside a bundle, the available ones up to itself; or missing ones.

    Attributes:
        first: the first number, from 1.
        last: the last number.
        sender: identifier of the sender, 16 bytes.
    """

    first: int
    last: int
    sender: bytes

    def encode(self) -> bytes:
        return _SPAN.pack(*self)

    @staticmethod
    def decode(data: bytes) -> Span | None:
        """Return the span, or None if these bytes are none."""
        if len(data) != _SPAN.size:
            return None
        span = Span(*_SPAN.unpack(data))
        return span if 1 <= span.first <= span.last < span.first + MOST_KEPT else None


class Bundler:
    """Sender of bundles.

    Args:
        session: the loop's session.
        domain: ROS domain.
        role: which loop it is.

    Attributes:
        topics: topics to add; for the plant, also commands, as it receives them.
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
        """Add a message; send the bundle once it is full."""
        head = HEAD.pack(len(topic), len(attachment), len(payload))
        self._waiting.append(head + topic + attachment + payload)
        if len(self._waiting) >= _MOST_MESSAGES or len(payload) >= _FULL_BYTES:
            self.send()

    def send(self) -> None:
        """Send all added messages, in several bundles if they are large.

        A message that is too large for the transport is sent alone, so no other is lost with it.
        """
        with self._lock:
            bundle: list[bytes] = []
            size = 0
            for _ in range(len(self._waiting)):  # in a flood, more arrive meanwhile
                message = self._waiting.popleft()
                size += len(message)
                if bundle and size > _FULL_BYTES:
                    self._send(b"".join(bundle))
                    bundle, size = [], len(message)
                bundle.append(message)
            if bundle:
                self._send(b"".join(bundle))

    def tell(self) -> None:
        """Report the number of bundles to recorders, which may lack the last ones."""
        with self._lock:
            if self._last:
                self._publisher.put(b"", self._span(self._last))

    def _send(self, bundle: bytes) -> None:
        if len(bundle) > _LARGEST_KEPT_BYTES:  # bundles too large to be sent must not be waited for
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
        """Send some missing bundles again; few at a time, so that the loop is not held up."""
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
        """Whether few enough requests came lately; recorders repeat those not answered."""
        now_s = time.monotonic()
        if now_s - self._answering_since_s >= 1.0:
            self._answered, self._answering_since_s = 0, now_s
        self._answered += 1
        return self._answered <= _MOST_ANSWERED_PER_S


def unbundled(bundle: bytes, topics: Mapping[bytes, Topic]) -> list[Received]:
    """Yield the messages in a bundle on these topics; a malformed message ends it.

    Recorders spend most time here, so one loop also decodes attachments as `Attachment.decode`
    does.
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
