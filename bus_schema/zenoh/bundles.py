"""Messages in bundles: what loops send, as a recorder takes it.

A recorder that subscribes to what loops send at every tick is a second peer to each `put`, and a
thread that is woken up each time, beside loops that wait for one another. So loops put all they
send into bundles too, and tell so by a token. Commands are told of by the plant, as it
takes them in, whoever sent them and whatever becomes of him. While nobody else has announced that
he speaks, a recorder takes bundles alone. Whoever subscribes to topics gets each message at once.
"""

from __future__ import annotations

import struct
import threading
from collections import deque
from collections.abc import Callable, Mapping

from bus_schema.messages.topics import JOINT_COMMANDS, TOPICS, Role, Topic, topics_of
from bus_schema.zenoh.access import bundle_key_expression, bundling_key_expression
from bus_schema.zenoh.ros_graph import ATTACHMENT, GID_BYTES, Attachment
from bus_schema.zenoh.session import Delivery, Mailbox, ZenohPublisher, ZenohSession

_LARGEST_BYTES = 1 << 16
_MOST_MESSAGES = 256
_TYPICAL_MESSAGES = 100
_MOST_HEARD = 1000  # of publishers; whoever makes up an id for each message fills no memory
_HEAD = struct.Struct("<BII")  # bytes of topic, attachment and payload, which follow
_BUNDLED = {
    Role.PLANT: [*topics_of(Role.PLANT), JOINT_COMMANDS],
    Role.CONTROLLER: [topic for topic in topics_of(Role.CONTROLLER) if topic is not JOINT_COMMANDS],
}
"""What the bundles of each loop hold; nobody says more in another's name."""
Received = tuple[Topic, bytes, int, int, bytes]
"""A message as a recorder takes it: topic, payload, and what its attachment says of it: number,
when it was sent (Unix time, ns) and id of its sender; `_UNKNOWN` where it has none."""
_UNKNOWN = Attachment(0, 0, b"")


class Bundler:
    """Sends bundles.

    Args:
        session: of the loop.
        domain: ROS domain.
        role: which loop it is.
    """

    def __init__(self, session: ZenohSession, domain: int, role: Role) -> None:
        self._publisher: ZenohPublisher = session.publisher(bundle_key_expression(domain, role))
        session.announce(bundling_key_expression(domain, role, session.identifier))
        self._kept: deque[bytes] = deque()
        self._lock = threading.Lock()

    def add(self, topic: bytes, attachment: bytes, payload: bytes) -> None:
        """Add a message; those that are many or large enough are sent."""
        head = _HEAD.pack(len(topic), len(attachment), len(payload))
        self._kept.append(head + topic + attachment + payload)
        if len(self._kept) >= _MOST_MESSAGES or len(payload) >= _LARGEST_BYTES:
            self.send()

    def send(self) -> None:
        """Send what was added since the last bundle, in more than one if it is much.

        A message that is too large for the transport takes no others along.
        """
        with self._lock:
            bundle: list[bytes] = []
            size = 0
            for _ in range(len(self._kept)):  # in a flood there are always more
                message = self._kept.popleft()
                size += len(message)
                if bundle and size > _LARGEST_BYTES:
                    self._publisher.put(b"".join(bundle), b"")
                    bundle, size = [], len(message)
                bundle.append(message)
            if bundle:
                self._publisher.put(b"".join(bundle), b"")


def unbundled(bundle: bytes, topics: Mapping[bytes, Topic]) -> list[Received]:
    """The messages in a bundle on these topics, by their names; what is no message ends it.

    Recorders spend their time here: one loop, which reads attachments as `Attachment.decode` does.
    """
    messages = []
    at, end, head_bytes, numbers_bytes = 0, len(bundle), _HEAD.size, ATTACHMENT.size
    while at + head_bytes <= end:
        name_bytes, attachment_bytes, payload_bytes = _HEAD.unpack_from(bundle, at)
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
            sequence, source_time_ns, gid = _UNKNOWN
        messages.append((topic, bundle[payload_at:at], sequence, source_time_ns, gid))
    return messages


class BundleMailbox:
    """All messages on our topics in a domain, each once, as ordered as their sender sent them.

    Args:
        session: of the recorder.
        domain: ROS domain.
        capacity: messages to keep.
        lossless: once there are more, senders wait; or else the oldest make room.
        speakers: gives the sessions that have announced that they send on our topics.
    """

    def __init__(
        self,
        session: ZenohSession,
        domain: int,
        capacity: int,
        *,
        lossless: bool,
        speakers: Callable[[], set[str]],
    ) -> None:
        self._session, self._domain = session, domain
        self._capacity, self._lossless = capacity, lossless
        self._speakers = speakers
        self._bundling: dict[str, str] = {}  # role by session
        self._left: set[str] = set()  # of these sessions
        self._lock = threading.Lock()
        self._topics = {topic.key_expression(domain): topic for topic in TOPICS}
        self._bundled_topics = {
            bundle_key_expression(domain, role): {
                topic.name.encode(): topic for topic in of_role if topic in TOPICS
            }
            for role, of_role in _BUNDLED.items()
        }
        self._bundled: set[bytes] = set()  # ids of publishers whose messages come in bundles
        self._heard: dict[tuple[str, bytes], int] = {}  # numbers that came before that was known
        self._bundles = session.mailbox(
            bundle_key_expression(domain), -(-capacity // _TYPICAL_MESSAGES), lossless=lossless
        )
        self._direct: Mailbox | None = None
        self._listen()
        session.watch_tokens(bundling_key_expression(domain), self._on_bundling)

    def take(self) -> list[Received] | None:
        """The oldest messages not yet taken, as many as came at once; None if nothing has come."""
        bundle = self._bundles.take()
        if bundle is not None:
            return self._unbundle(*bundle)
        left = self._left.copy()
        delivery = self._direct.take() if self._direct is not None else None
        if delivery is None:
            self._forget(left)
            self._listen()
            return None
        key, (payload, attachment) = delivery
        topic = self._topics.get(key)
        if topic is None:
            return []
        message = (topic, payload, *(Attachment.decode(attachment) or _UNKNOWN))
        return [] if self._will_be_bundled(message) else [message]

    def _unbundle(self, key: str, bundle: Delivery) -> list[Received]:
        """The messages of a bundle but those that have come by themselves."""
        messages = unbundled(bundle.payload, self._bundled_topics.get(key, {}))
        self._bundled.update(gid for topic, _, _, _, gid in messages if topic is not JOINT_COMMANDS)
        if self._heard:  # only at the beginning
            messages = [message for message in messages if self._is_new(message)]
        return messages

    def _is_new(self, message: Received) -> bool:
        """Whether a message in a bundle has not come by itself before."""
        topic, _, sequence, _, gid = message
        if not sequence:  # of a stranger; not known from others of his
            return True
        heard = self._heard.get((topic.name, gid), 0)
        if sequence < heard:
            return False
        self._heard.pop((topic.name, gid), None)
        return sequence > heard

    def _will_be_bundled(self, message: Received) -> bool:
        """Whether a message that has come by itself comes in a bundle too, if it has not yet."""
        topic, _, sequence, _, gid = message
        if topic is JOINT_COMMANDS and Role.PLANT in self._bundling.values():
            return True
        if not sequence:
            return False
        if gid not in self._bundled and len(self._heard) < _MOST_HEARD:
            self._heard[topic.name, gid] = sequence
        return gid in self._bundled

    def _listen(self) -> None:
        """Listen to all that is sent, unless all of it comes in bundles."""
        if (
            set(self._bundling.values()) != set(_BUNDLED)
            or not self._speakers() <= self._bundling.keys()
        ):
            if self._direct is None:
                key = f"{self._domain}/**"
                self._direct = self._session.mailbox(key, self._capacity, lossless=self._lossless)
        elif self._direct is not None:
            self._direct.close()
            self._direct = None

    def _on_bundling(self, token: str, alive: bool) -> None:
        *_, role, session = token.split("/")
        with self._lock:
            if alive:
                self._bundling[session] = role
                self._left.discard(session)
            else:
                self._left.add(session)

    def _forget(self, left: set[str]) -> None:
        """Sessions have left, and all that came by itself before was held against their bundles."""
        with self._lock:
            for session in left & self._left:
                self._left.discard(session)
                self._bundling.pop(session, None)
