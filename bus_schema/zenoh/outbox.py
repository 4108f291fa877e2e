"""Outgoing messages of a node: urgent ones at once, the others in batches."""

from __future__ import annotations

import logging
import threading
import time
from collections import deque
from dataclasses import dataclass

from bus_schema.messages.topics import Rate, Topic
from bus_schema.zenoh.bundles import Bundler
from bus_schema.zenoh.ros_graph import Attachment
from bus_schema.zenoh.session import ZenohPublisher

logger = logging.getLogger(__name__)

_BATCH = 32
_LONGEST_WAIT_NS = 20_000_000
"""With rare ticks, a full batch would keep viewers waiting."""


LARGEST_LEAD_BYTES = 1 << 19
"""Half of a peer's queue, which holds 16 batches of up to 64 KiB."""
OVERHEAD_BYTES = 100
"""Bytes that each message adds in the queue: key, attachment, headers."""
_PATIENCE_S = 60.0
_FIRST_PATIENCE_S = 15.0
"""Patience before a recorder's first report, which a slow machine may delay."""


@dataclass(eq=False, slots=True)
class Stream:
    """The messages of one topic.

    Attributes:
        topic: their topic.
        name: its name in bundles.
        publisher: the publisher that sends them.
        gid: id of the publisher in the ROS graph.
        is_bundled: whether they go into bundles too.
        sequence: number of the last message.
    """

    topic: Topic
    name: bytes
    publisher: ZenohPublisher
    gid: bytes
    is_bundled: bool
    sequence: int = 0


class FlowControl:
    """Limits how far a sender may be ahead of recorders, where no recorded message may be lost.

    A message to a full queue is dropped (`session.py`), so that no subscriber delays a loop. So
    recorders report their progress, and a sender that is too far ahead of one waits for it, well
    before a queue is full. It does not wait for other subscribers.

    Args:
        patience_s: time that the sender waits for a silent recorder before it ignores it.
        first_patience_s: the same before the recorder's first report.

    Attributes:
        recorders: sequence number that each recorder has, by session.
    """

    def __init__(
        self, patience_s: float = _PATIENCE_S, first_patience_s: float = _FIRST_PATIENCE_S
    ) -> None:
        self._patience_s = patience_s
        self._first_patience_s = min(patience_s, first_patience_s)
        self._sent_bytes = self._recorded_bytes = 0
        self._marks: deque[tuple[int, int]] = deque()  # sequence, bytes sent up to and including it
        self._last_mark = 0
        self.recorders: dict[str, int] = {}
        self._silent: set[str] = set()  # of these, those that have reported nothing yet
        self._change = threading.Condition()

    def join(self, recorder: str) -> None:
        """Add a recorder, which receives all messages from now on."""
        with self._change:
            if recorder not in self.recorders:
                self.recorders[recorder] = self._last_mark
                self._silent.add(recorder)

    def leave(self, recorder: str) -> None:
        """Remove a recorder; the sender no longer waits for it."""
        with self._change:
            self._drop(recorder)
            self._change.notify_all()

    def send(self, size_bytes: int, mark: int = 0) -> None:
        """Count messages sent; `mark` is the number that recorders will acknowledge, if any."""
        with self._change:
            self._sent_bytes += size_bytes
            if mark:
                self._marks.append((mark, self._sent_bytes))
                self._last_mark = mark

    def acknowledge(self, recorder: str, mark: int) -> None:
        """Note that a recorder has all messages up to a mark."""
        with self._change:
            if recorder in self.recorders:
                self._silent.discard(recorder)
                newest = min(mark, self._last_mark)
                self.recorders[recorder] = max(newest, self.recorders[recorder])
                self._change.notify_all()

    def await_recorders(self) -> None:
        """Wait until no recorder is too far behind."""
        with self._change:
            patience_s = self._first_patience_s if self._silent else self._patience_s
            if self._change.wait_for(self._may_send, patience_s):
                return
            self._first_patience_s = 0.0  # one wait for all silent ones, and for later ones
            late = [each for each in self._silent if self.recorders[each] < self._last_mark]
            for each in late or [min(self.recorders, key=self.recorders.__getitem__)]:
                self._drop(each)
        logger.warning(
            "a recorder has recorded nothing for %g s, and is waited for no longer: what it misses"
            " it counts as lost", patience_s,
        )  # fmt: skip

    def _drop(self, recorder: str) -> None:
        self.recorders.pop(recorder, None)
        self._silent.discard(recorder)

    def _may_send(self) -> bool:
        slowest = min(self.recorders.values(), default=self._last_mark)
        while self._marks and self._marks[0][0] <= slowest:
            self._recorded_bytes = self._marks.popleft()[1]
        return not self.recorders or (self._sent_bytes - self._recorded_bytes <= LARGEST_LEAD_BYTES)


class Outbox:
    """Sender of a node's messages.

    Messages that are not urgent are sent in batches: each message sent alone wakes its receivers,
    and on few cores these wake-ups delay the loops.

    Args:
        bundler: also bundles all messages for recorders; None where recorders subscribe to topics.
        flow: delays the sender when recorders are too far behind; None for no waiting.
    """

    def __init__(self, bundler: Bundler | None, flow: FlowControl | None) -> None:
        self._bundler, self._flow = bundler, flow
        self._streams: dict[str, Stream] = {}
        self._waiting: list[tuple[Stream, bytes, bytes]] = []
        self._lock = threading.Lock()
        self._since_ns = 0
        self._sent_bytes = self._mark = 0

    def add(self, topic: Topic, publisher: ZenohPublisher, gid: bytes) -> None:
        """Add a topic to send."""
        is_bundled = self._bundler is not None and topic in self._bundler.topics
        self._streams[topic.name] = Stream(topic, topic.name.encode(), publisher, gid, is_bundled)

    def gids(self) -> set[bytes]:
        """Ids of the publishers."""
        return {stream.gid for stream in list(self._streams.values())}

    def gid_of(self, topic: Topic) -> bytes | None:
        """Return the id of a topic's publisher; None without one."""
        stream = self._streams.get(topic.name)
        return None if stream is None else stream.gid

    def send(self, topic: Topic, payload: bytes, beside: bytes) -> int:
        """Send a message; return its sequence number. The bytes `beside` follow the attachment."""
        stream = self._streams[topic.name]
        stream.sequence = sequence = stream.sequence + 1
        attachment = Attachment(sequence, time.time_ns(), stream.gid).encode()
        if topic.urgent:
            stream.publisher.put(payload, attachment + beside)
        if self._bundler is not None and stream.is_bundled:
            self._bundler.add(stream.name, attachment, payload)
        if self._flow is not None:
            self._sent_bytes += len(payload) + len(beside) + OVERHEAD_BYTES
            if topic.paces:
                self._mark = sequence
        if not topic.urgent:
            self._keep(stream, payload, attachment)
        return sequence

    def _keep(self, stream: Stream, payload: bytes, attachment: bytes) -> None:
        now_ns = time.monotonic_ns()
        with self._lock:
            if not self._waiting:
                self._since_ns = now_ns
            self._waiting.append((stream, payload, attachment))
            is_full = len(self._waiting) >= _BATCH or now_ns - self._since_ns > _LONGEST_WAIT_NS
            if is_full or stream.topic.rate is Rate.EVENT:
                self._send_what_waits()
        if is_full and self._flow is not None:
            self._flow.await_recorders()

    def _send_what_waits(self) -> None:
        unheard = self._streams_without_listeners()
        for stream, payload, attachment in self._waiting:
            if stream not in unheard:
                stream.publisher.put(payload, attachment)
        self._waiting.clear()
        if self._bundler is not None:
            self._bundler.send()
        if self._flow is not None:
            self._flow.send(self._sent_bytes, self._mark)
            self._sent_bytes = self._mark = 0

    def _streams_without_listeners(self) -> set[Stream]:
        """Return the streams whose only subscribers are recorders, which read bundles."""
        if self._bundler is None:
            return set()
        ticking = {stream for stream, _, _ in self._waiting if stream.topic.paces}
        return {stream for stream in ticking if not stream.publisher.has_subscribers()}
