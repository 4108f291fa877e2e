"""A relay between two TCP peers that holds every byte back for a constant time, each way.

What an emulated delay leaves out is here: the bytes are on a real connection for as long, with the
scheduling of the machine, the transport's own buffers and two processes that really are apart.
"""

from __future__ import annotations

import contextlib
import select
import socket
import time
from collections import Counter, deque
from collections.abc import Callable
from typing import Any

import numpy as np

from bus_schema.percentiles import percentiles

_CHUNK_BYTES = 1 << 16
_MOST_HELD_BYTES = 1 << 22
"""A direction whose receiver does not read takes in no more than this: the sender feels it."""
_CONNECT_TIMEOUT_S = 1.0
_LOOK_UP_S = 0.1
"""How long the relay waits at most before it looks whether it is to stop."""


class DelayLine:
    """Chunks of bytes, each held back for a constant time; an empty one is the end.

    Args:
        delay_ns: how long.

    Attributes:
        held_bytes: what is in it.
    """

    def __init__(self, delay_ns: int) -> None:
        self._delay_ns = delay_ns
        self._chunks: deque[tuple[int, bytes]] = deque()
        self.held_bytes = 0

    def put(self, chunk: bytes, now_ns: int) -> None:
        """Take in a chunk that came at `now_ns`, which never goes back."""
        self._chunks.append((now_ns + self._delay_ns, chunk))
        self.held_bytes += len(chunk)

    @property
    def next_due_ns(self) -> int | None:
        """When the oldest chunk is to leave; None if there is none."""
        return self._chunks[0][0] if self._chunks else None

    def take_due(self, now_ns: int) -> tuple[int, bytes] | None:
        """The oldest chunk, with the instant it was due at; None if nothing is due by now."""
        if not self._chunks or self._chunks[0][0] > now_ns:
            return None
        due_ns, chunk = self._chunks.popleft()
        self.held_bytes -= len(chunk)
        return due_ns, chunk


class DelayedStream:
    """One direction of a connection.

    Args:
        source: where the bytes come from; does not block.
        sink: where they go; does not block.
        delay_ns: how long they are held back.
        note_left: told of each chunk how late it left, ns.

    Attributes:
        is_over: the end has been passed on, or the sink is gone.
    """

    def __init__(
        self,
        source: socket.socket,
        sink: socket.socket,
        delay_ns: int,
        note_left: Callable[[int], None],
    ) -> None:
        self.source, self.sink = source, sink
        self._line = DelayLine(delay_ns)
        self._note_left = note_left
        self._leaving: tuple[int, bytes] | None = None
        self._has_ended = False
        self.is_over = False

    @property
    def next_due_ns(self) -> int | None:
        """When something is to leave; None if nothing is, or the sink must take more first."""
        return None if self._leaving else self._line.next_due_ns

    @property
    def wants_to_read(self) -> bool:
        """Whether more may come in."""
        return not self._has_ended and self._line.held_bytes < _MOST_HELD_BYTES

    @property
    def wants_to_write(self) -> bool:
        """Whether something that was due is still here, for the sink takes no more."""
        return self._leaving is not None

    def take_in(self, now_ns: Callable[[], int]) -> None:
        """Read what has come; a broken connection ends as one that is closed."""
        try:
            chunk = self.source.recv(_CHUNK_BYTES)
        except BlockingIOError:
            return
        except OSError:
            chunk = b""
        self._has_ended = not chunk
        self._line.put(chunk, now_ns())

    def let_go(self, now_ns: Callable[[], int]) -> None:
        """Send what is due, as far as the sink takes it."""
        try:
            while leaving := self._leaving or self._line.take_due(now_ns()):
                due_ns, chunk = leaving
                if not chunk:
                    self.is_over = True
                    self.sink.shutdown(socket.SHUT_WR)
                    return
                self._leaving = leaving
                rest = chunk[self.sink.send(chunk) :]
                self._leaving = (due_ns, rest) if rest else None
                if not rest:
                    self._note_left(now_ns() - due_ns)
        except BlockingIOError:
            return
        except OSError:
            self._has_ended, self.is_over, self._leaving = True, True, None


class DelayRelay:
    """Takes connections and passes them on.

    Args:
        listener: where connections come in.
        target: host and port that each of them is passed on to.
        delay_ns: how long bytes are held back, each way.
        now_ns: the clock.
    """

    def __init__(
        self,
        listener: socket.socket,
        target: tuple[str, int],
        delay_ns: int,
        now_ns: Callable[[], int] = time.monotonic_ns,
    ) -> None:
        self._listener, self._target = listener, target
        self._delay_ns, self._now_ns = delay_ns, now_ns
        self._connections: list[tuple[DelayedStream, DelayedStream]] = []
        self._lateness_us: Counter[int] = Counter()

    def run(self, is_stop_requested: Callable[[], bool]) -> None:
        """Relay until it is to stop."""
        try:
            while not is_stop_requested():
                self.step(_LOOK_UP_S)
        finally:
            for connection in self._connections:
                _close(connection)

    def step(self, longest_wait_s: float) -> None:
        """Wait until something is due or comes in, and deal with it."""
        streams = [stream for connection in self._connections for stream in connection]
        dues = [stream.next_due_ns for stream in streams]
        next_due_ns = min((due for due in dues if due is not None), default=None)
        wait_s = longest_wait_s
        if next_due_ns is not None:
            wait_s = min(wait_s, max(next_due_ns - self._now_ns(), 0) * 1e-9)
        reading = {stream.source: stream for stream in streams if stream.wants_to_read}
        writing = [stream.sink for stream in streams if stream.wants_to_write]
        # Not epoll, which waits in whole milliseconds; and there are few of them.
        ready, _, _ = select.select([self._listener, *reading], writing, [], wait_s)
        for each in ready:
            if each is self._listener:
                self._accept()
            else:
                reading[each].take_in(self._now_ns)
        for stream in streams:
            stream.let_go(self._now_ns)
        self._drop_what_is_over()

    def lateness_us(self) -> dict[str, Any]:
        """Percentiles of how much later than due the chunks left, in whole µs."""
        values = np.array(sorted(self._lateness_us), dtype=np.int64)
        counts = np.array([self._lateness_us[each] for each in values.tolist()], dtype=np.int64)
        return percentiles(values, counts)

    @property
    def chunks(self) -> int:
        """Chunks that were passed on."""
        return self._lateness_us.total()

    def _accept(self) -> None:
        """Take a connection; one that the target does not take is closed, and may come again."""
        try:
            near, _ = self._listener.accept()
        except OSError:  # whoever it was has given up
            return
        try:
            far = socket.create_connection(self._target, _CONNECT_TIMEOUT_S)
        except OSError:
            near.close()
            return
        for each in (near, far):
            each.setblocking(False)
            each.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._connections.append(
            (
                DelayedStream(near, far, self._delay_ns, self._note_left),
                DelayedStream(far, near, self._delay_ns, self._note_left),
            )
        )

    def _note_left(self, late_ns: int) -> None:
        self._lateness_us[late_ns // 1000] += 1

    def _drop_what_is_over(self) -> None:
        for connection in [each for each in self._connections if all(one.is_over for one in each)]:
            _close(connection)
            self._connections.remove(connection)


def _close(connection: tuple[DelayedStream, DelayedStream]) -> None:
    for stream in connection:
        with contextlib.suppress(OSError):
            stream.source.close()
