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
from collections.abc import Callable, Iterator

from bus_schema.messages.topics import JOINT_COMMANDS, Role, topics_of
from bus_schema.zenoh.access import bundle_key_expression, bundling_key_expression
from bus_schema.zenoh.ros_graph import GID_BYTES, Attachment
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


def unbundled(bundle: bytes) -> Iterator[tuple[bytes, Delivery]]:
    """Topic and content of each message; what is no message ends it."""
    at, end = 0, len(bundle)
    while at + _HEAD.size <= end:
        name_bytes, attachment_bytes, payload_bytes = _HEAD.unpack_from(bundle, at)
        name_at = at + _HEAD.size
        attachment_at = name_at + name_bytes
        payload_at = attachment_at + attachment_bytes
        at = payload_at + payload_bytes
        if at <= end:
            yield (
                bundle[name_at:attachment_at],
                Delivery(bundle[payload_at:at], bundle[attachment_at:payload_at]),
            )


class BundleMailbox:
    """All that is sent in a domain, each message once, in the order in which its sender sent it.

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
        self._keys = {
            bundle_key_expression(domain, role): {
                topic.name.encode(): topic.key_expression(domain) for topic in of_role
            }
            for role, of_role in _BUNDLED.items()
        }
        self._unbundled: deque[tuple[str, Delivery]] = deque()
        self._commands = JOINT_COMMANDS.key_expression(domain)
        self._bundled: set[bytes] = set()  # ids of publishers whose messages come in bundles
        self._heard: dict[tuple[str, bytes], int] = {}  # numbers that came before that was known
        self._bundles = session.mailbox(
            bundle_key_expression(domain), -(-capacity // _TYPICAL_MESSAGES), lossless=lossless
        )
        self._direct: Mailbox | None = None
        self._listen()
        session.watch_tokens(bundling_key_expression(domain), self._on_bundling)

    def take(self) -> tuple[str, Delivery] | None:
        """Key and content of the oldest delivery not yet taken; None if there is none."""
        while not self._unbundled:
            bundle = self._bundles.take()
            if bundle is not None:
                self._unbundle(*bundle)
                continue
            delivery = self._direct.take() if self._direct is not None else None
            if delivery is None:
                self._listen()
                return None
            if not self._will_be_bundled(*delivery):
                return delivery
        return self._unbundled.popleft()

    def _unbundle(self, key: str, bundle: Delivery) -> None:
        keys = self._keys.get(key, {})
        for topic, delivery in unbundled(bundle.payload):
            if topic in keys and self._is_new(keys[topic], delivery.attachment):
                self._unbundled.append((keys[topic], delivery))

    def _is_new(self, key: str, attachment: bytes) -> bool:
        """Whether a message in a bundle has not come by itself before."""
        if key != self._commands:
            self._bundled.add(attachment[-GID_BYTES:])
        if not self._heard:  # as ever but at the beginning
            return True
        sent = Attachment.decode(attachment)
        if sent is None or not sent.sequence:  # of a stranger; not known from others of his
            return True
        heard = self._heard.get((key, sent.gid), 0)
        if sent.sequence < heard:
            return False
        self._heard.pop((key, sent.gid), None)
        return sent.sequence > heard

    def _will_be_bundled(self, key: str, delivery: Delivery) -> bool:
        """Whether a message that has come by itself comes in a bundle too, if it has not yet."""
        if key == self._commands and Role.PLANT in self._bundling.values():
            return True
        sent = Attachment.decode(delivery.attachment)
        if sent is None or not sent.sequence:
            return False
        if sent.gid not in self._bundled and len(self._heard) < _MOST_HEARD:
            self._heard[key, sent.gid] = sent.sequence
        return sent.gid in self._bundled

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
        if alive:
            self._bundling[session] = role
        else:
            self._bundling.pop(session, None)
