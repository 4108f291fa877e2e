"""What a node sends: at once what somebody waits for, the rest with some more of its kind."""

from __future__ import annotations

import threading
import time

from bus_schema.messages.topics import Rate, Topic
from bus_schema.zenoh.bundles import Bundler
from bus_schema.zenoh.flow_control import OVERHEAD_BYTES, FlowControl
from bus_schema.zenoh.ros_graph import Attachment
from bus_schema.zenoh.session import ZenohPublisher

_BATCH = 32
_LONGEST_WAIT_NS = 20_000_000
"""Where ticks are far apart, a batch of them would keep who looks on waiting."""


class Stream:
    """The messages of one topic.

    Args:
        topic: their topic.
        publisher: sends them.
        gid: id of the publisher in the ROS graph.
        is_bundled: whether they go into bundles too.
    """

    def __init__(
        self, topic: Topic, publisher: ZenohPublisher, gid: bytes, *, is_bundled: bool
    ) -> None:
        self.publisher, self.gid = publisher, gid
        self.name = topic.name.encode()
        self.is_urgent, self.paces = topic.urgent, topic.paces
        self.is_event = topic.rate is Rate.EVENT
        self.is_bundled = is_bundled
        self.sequence = 0


class Outbox:
    """Sends the messages of a node.

    What is not urgent waits for some more of its kind: each message that leaves alone costs its
    receivers a wake-up, and on few cores these wake-ups get in the way of the loops.

    Args:
        bundler: takes everything for recorders too; None where recorders take each by itself.
        flow: holds the sender back where recorders are too far behind; None for no waiting.
    """

    def __init__(self, bundler: Bundler | None, flow: FlowControl | None) -> None:
        self._bundler, self._flow = bundler, flow
        self._streams: dict[str, Stream] = {}
        self._waiting: list[tuple[Stream, bytes, bytes]] = []
        self._lock = threading.Lock()
        self._since_ns = 0
        self._sent_bytes = self._mark = 0

    def add(self, topic: Topic, publisher: ZenohPublisher, gid: bytes) -> None:
        """From now on send a topic too."""
        is_bundled = self._bundler is not None and topic in self._bundler.topics
        self._streams[topic.name] = Stream(topic, publisher, gid, is_bundled=is_bundled)

    def gids(self) -> set[bytes]:
        """Ids of the publishers."""
        return {stream.gid for stream in list(self._streams.values())}

    def gid_of(self, topic: Topic) -> bytes | None:
        """Id of the publisher of a topic; None without one."""
        stream = self._streams.get(topic.name)
        return None if stream is None else stream.gid

    def send(self, topic: Topic, payload: bytes, beside: bytes) -> int:
        """Send a message; its sequence number. What goes `beside` it follows the attachment."""
        stream = self._streams[topic.name]
        stream.sequence = sequence = stream.sequence + 1
        attachment = Attachment(sequence, time.time_ns(), stream.gid).encode()
        if stream.is_urgent:
            stream.publisher.put(payload, attachment + beside)
        if self._bundler is not None and stream.is_bundled:
            self._bundler.add(stream.name, attachment, payload)
        if self._flow is not None:
            self._sent_bytes += len(payload) + len(beside) + OVERHEAD_BYTES
            if stream.paces:
                self._mark = sequence
        if not stream.is_urgent:
            self._keep(stream, payload, attachment)
        return sequence

    def _keep(self, stream: Stream, payload: bytes, attachment: bytes) -> None:
        now_ns = time.monotonic_ns()
        with self._lock:
            if not self._waiting:
                self._since_ns = now_ns
            self._waiting.append((stream, payload, attachment))
            is_full = len(self._waiting) >= _BATCH or now_ns - self._since_ns > _LONGEST_WAIT_NS
            if is_full or stream.is_event:
                self._send_what_waits()
        if is_full and self._flow is not None:
            self._flow.await_recorders()

    def _send_what_waits(self) -> None:
        unheard = self._unheard()
        for stream, payload, attachment in self._waiting:
            if stream not in unheard:
                stream.publisher.put(payload, attachment)
        self._waiting.clear()
        if self._bundler is not None:
            self._bundler.send()
        if self._flow is not None:
            self._flow.send(self._sent_bytes, self._mark)
            self._sent_bytes = self._mark = 0

    def _unheard(self) -> set[Stream]:
        """What recorders have from bundles, and nobody else subscribes to."""
        if self._bundler is None:
            return set()
        ticking = {stream for stream, _, _ in self._waiting if stream.paces}
        return {stream for stream in ticking if not stream.publisher.has_subscribers()}
