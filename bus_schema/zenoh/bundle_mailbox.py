"""All messages of a domain for a recorder: from bundles, or directly from senders without them."""

from __future__ import annotations

import threading
import time
from collections import Counter, deque
from collections.abc import Callable
from functools import partial

from bus_schema.errors import InvalidMessageError
from bus_schema.messages.run_event import RunEvent
from bus_schema.messages.topics import CLOCK, JOINT_COMMANDS, RUN_EVENTS, TOPICS, Role, Topic
from bus_schema.zenoh.access import (
    bundle_key_expression,
    bundling_key_expression,
    missed_key_expression,
)
from bus_schema.zenoh.bundle_order import BundleOrder
from bus_schema.zenoh.bundles import BUNDLED, UNKNOWN, Received, Span, unbundled
from bus_schema.zenoh.ros_graph import Attachment, RosGraph
from bus_schema.zenoh.session import Delivery, ZenohSession

WRONG_ROLE = "wrong_role"
_RECORDED: dict[str, dict[bytes, Topic]] = {
    role: {topic.name.encode(): topic for topic in of_role if topic is not CLOCK}
    for role, of_role in BUNDLED.items()
}
"""Topics that a recorder takes from the bundles of each loop, by their names in bundles."""
_OBJECT_BYTES = 300
"""Memory of Python's objects around each delivery that is kept."""
_MOST_SENDERS = 32
"""Limit on senders, so that invented ids cannot fill the memory."""


class Mailbox:
    """Queue of deliveries on a key, up to so many bytes; they are taken in bulk.

    Once it is full, senders wait, or the oldest delivery is dropped.

    Each delivery is copied on arrival: a sample of Zenoh keeps 64 KiB, however small it is.

    Attributes:
        dropped: deliveries removed, before they were taken, to make room for newer ones.
    """

    def __init__(self, session: ZenohSession, key: str, *, most_bytes: int, lossless: bool) -> None:
        self._most_bytes, self._lossless = most_bytes, lossless
        self._deliveries: deque[tuple[str, Delivery]] = deque()
        self._bytes = self.dropped = 0
        self._is_closed = False
        self._change = threading.Condition()
        self._unsubscribe = session.collect(key, self._add)

    def take(self) -> tuple[str, Delivery] | None:
        """Return key and content of the oldest delivery not yet taken; None if there is none."""
        if not self._deliveries:
            return None
        with self._change:
            oldest = self._take_oldest()
            if self._lossless:
                self._change.notify()
        return oldest

    def close(self) -> None:
        """Unsubscribe; deliveries not yet taken are lost."""
        with self._change:
            self._is_closed = True
            self._change.notify()
        self._unsubscribe()

    def _add(self, key: str, delivery: Delivery) -> None:
        """Keep a delivery; if full, block its sender or drop the oldest ones."""
        new = key, delivery
        size = _size(new)
        with self._change:
            if self._lossless:
                self._change.wait_for(lambda: self._is_closed or self._has_room(size))
            while not self._has_room(size):
                self._take_oldest()
                self.dropped += 1
            self._deliveries.append(new)
            self._bytes += size

    def _has_room(self, size_bytes: int) -> bool:
        return self._bytes + size_bytes <= self._most_bytes or not self._deliveries

    def _take_oldest(self) -> tuple[str, Delivery]:
        oldest = self._deliveries.popleft()
        self._bytes -= _size(oldest)
        return oldest


class BundleMailbox:
    """All messages on our topics in a domain, each once, in the order of their sender.

    The direct messages of a session that bundles are ignored, as its bundles contain them.

    Args:
        session: the recorder's session.
        domain: ROS domain.
        most_bytes: largest size of the messages kept, for bundles and direct messages each.
        lossless: beyond that size, senders wait; otherwise the oldest messages are dropped.
        graph: who is on the bus.
        by_role: accept events of the loops only in their bundles, which only keys of that role can
            send; anyone with a key of the domain can send direct events.

    Attributes:
        rejected: number of rejections by reason: bundles that their senders cannot have sent
            (`bundle_order`), and run events that name another loop than their sender.
    """

    def __init__(
        self,
        session: ZenohSession,
        domain: int,
        most_bytes: int,
        *,
        lossless: bool,
        graph: RosGraph,
        by_role: bool,
    ) -> None:
        self._domain, self._by_role = domain, by_role
        self._mailbox = partial(Mailbox, session, most_bytes=most_bytes, lossless=lossless)
        self._graph = graph
        self.rejected: Counter[str] = Counter()
        self._bundling: dict[str, str] = {}  # role by session
        self._have_bundled: set[str] = set()  # roles
        self._left: set[str] = set()  # of these sessions
        self._lock = threading.Lock()
        self._topics = {topic.key_expression(domain): topic for topic in TOPICS}
        self._orders: dict[tuple[str, bytes], BundleOrder] = {}  # by role and sender
        self._waits = True
        self._missed = session.publisher(missed_key_expression(domain))
        self._bundles = self._mailbox(bundle_key_expression(domain))
        self._direct: Mailbox | None = None
        self._dropped = 0  # in mailboxes that are closed
        self._listen()
        session.watch_tokens(bundling_key_expression(domain), self._on_bundling)

    def take(self) -> list[Received] | None:
        """Return the oldest messages not yet taken, all of one arrival; None if there are none."""
        bundle = self._bundles.take()
        if bundle is not None:
            key, delivery = bundle
            return self._unbundle(key.rpartition("/")[2], delivery)
        left = self._left.copy()
        alone = self._direct.take() if self._direct is not None else None
        if alone is None:
            self._forget_left(left)
            self._listen()
            return self._request_missed()
        key, (payload, attachment) = alone
        topic = self._topics.get(key)
        if topic is None:
            return []
        message = (topic, payload, *(Attachment.decode(attachment) or UNKNOWN))
        return [] if self._is_bundled(message) else self._without_forgeries([message], None)

    @property
    def dropped(self) -> int:
        """Number of deliveries dropped to make room for newer ones."""
        boxes = (self._bundles, self._direct)
        return self._dropped + sum(box.dropped for box in boxes if box is not None)

    def let_go(self) -> list[Received]:
        """Stop waiting for missing bundles; return the messages of those that waited."""
        self._waits = False
        return self._all_of(BundleOrder.rest)

    def _unbundle(self, role: str, bundle: Delivery) -> list[Received]:
        """Return the messages of a bundle and of those that waited for it; none before its turn."""
        span = Span.decode(bundle.attachment)
        if span is None:
            return self._messages_in([bundle.payload], role)
        order = self._orders.get((role, span.sender))
        if order is None:
            if len(self._orders) >= _MOST_SENDERS:
                return self._messages_in([bundle.payload], role)
            order = self._orders[role, span.sender] = BundleOrder(span.sender, self.rejected)
        ready = order.take_in(span, bundle.payload)
        return self._messages_in(ready if self._waits else [*ready, *order.rest()], role)

    def _request_missed(self) -> list[Received] | None:
        """Request missing bundles, and give up those requested in vain too often."""
        now_s = time.monotonic()
        for order in self._orders.values():
            missed = order.missed(now_s)
            if missed is not None:
                self._missed.put(missed.encode(), b"")
        return self._all_of(BundleOrder.overdue) or None

    def _all_of(self, bundles_of: Callable[[BundleOrder], list[bytes]]) -> list[Received]:
        return [
            message
            for (role, _), order in self._orders.items()
            for message in self._messages_in(bundles_of(order), role)
        ]

    def _messages_in(self, bundles: list[bytes], role: str) -> list[Received]:
        topics = _RECORDED.get(role, {})
        messages = [message for bundle in bundles for message in unbundled(bundle, topics)]
        return self._without_forgeries(messages, role)

    def _without_forgeries(self, messages: list[Received], role: str | None) -> list[Received]:
        """Filter a role's bundled messages, or direct ones: no event in another role's name."""
        believed = [
            message for message in messages
            if message[0] is not RUN_EVENTS or self._may_send(message[1], role)
        ]  # fmt: skip
        if len(believed) < len(messages):
            self.rejected[WRONG_ROLE] += len(messages) - len(believed)
        return believed

    def _may_send(self, event: bytes, role: str | None) -> bool:
        try:
            source = RunEvent.decode(event).source
        except InvalidMessageError:
            return True  # no reader can decode it either
        if role is not None:
            return source == role
        return not ((source in BUNDLED and self._by_role) or source in self._have_bundled)

    def _is_bundled(self, message: Received) -> bool:
        """Whether a direct message is also sent in a bundle."""
        topic, _, _, _, gid = message
        if topic is JOINT_COMMANDS and Role.PLANT in self._bundling.values():
            return True
        return self._graph.sessions.get(gid) in self._bundling

    def _listen(self) -> None:
        """Subscribe to direct messages, unless every sender bundles."""
        both_bundle = set(self._bundling.values()) == set(BUNDLED)
        if not both_bundle or not self._graph.speakers() <= self._bundling.keys():
            if self._direct is None:
                self._direct = self._mailbox(f"{self._domain}/**")
        elif self._direct is not None:
            self._direct.close()
            self._dropped += self._direct.dropped
            self._direct = None

    def _on_bundling(self, token: str, alive: bool) -> None:
        *_, role, session = token.split("/")
        with self._lock:
            if alive:
                self._bundling[session] = role
                self._have_bundled.add(role)
                self._left.discard(session)
            else:
                self._left.add(session)

    def _forget_left(self, left: set[str]) -> None:
        """Forget sessions that left, after all their direct messages have been handled."""
        with self._lock:
            for session in left & self._left:
                self._left.discard(session)
                self._bundling.pop(session, None)


def _size(kept: tuple[str, Delivery]) -> int:
    """Return the memory that a delivery takes, with the objects around it, bytes."""
    key, (payload, attachment) = kept
    return len(key) + len(payload) + len(attachment) + _OBJECT_BYTES
