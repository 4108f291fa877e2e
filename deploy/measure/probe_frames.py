"""The frames of the link probe, and the side that answers them.

A frame says when it was sent. Its answer also says when it arrived there and when that was
answered, and repeats the arrivals of the frames before it: so what was lost on the way back is
distinguished from what never came. Answers are as long as questions, and no more than one each.
"""

from __future__ import annotations

import contextlib
import select
import socket
import struct
import time
from collections.abc import Callable, Iterator
from typing import NamedTuple, Self

from bus_schema.runtime.clock import own_kernel

REPEATED = 8
_HEADER = struct.Struct(f"<4sIIIIqq{REPEATED}q")
_MAGIC = b"fhl1"
LEAST_BYTES, MOST_BYTES = _HEADER.size, 60_000
_MOST_SESSIONS = 1000
_POLL_S = 0.1


class ProbeFrame(NamedTuple):
    """A frame; instants are on the monotonic clock of the side named, ns, 0 for none.

    Attributes:
        size: of the whole frame, bytes.
        session: number of the measurement.
        number: of the frame, from 0.
        kernel: tells whose clock it is: monotonic clocks under one kernel are the same.
        sent_ns: when it was sent.
        answered_ns: when it was answered, on the other side.
        received_ns: arrivals on the other side, of this frame and of those before it.
    """

    size: int
    session: int
    number: int
    kernel: int
    sent_ns: int
    answered_ns: int = 0
    received_ns: tuple[int, ...] = (0,) * REPEATED

    def encode(self) -> bytes:
        return _HEADER.pack(_MAGIC, *self[:-1], *self.received_ns).ljust(self.size, b"\0")

    @classmethod
    def decode(cls, data: bytes) -> Self | None:
        """The frame in these bytes; None where there is none."""
        if len(data) < LEAST_BYTES:
            return None
        magic, size, session, number, kernel, sent, answered, *received = _HEADER.unpack_from(data)
        if magic != _MAGIC or not LEAST_BYTES <= size <= MOST_BYTES:
            return None
        return cls(size, session, number, kernel, sent, answered, tuple(received))


class FrameStream:
    """The frames of a connection, which come in pieces."""

    def __init__(self) -> None:
        self._buffer = b""

    def cut(self, data: bytes) -> Iterator[ProbeFrame]:
        """Those that are complete with these bytes.

        Raises:
            ValueError: these are no frames.
        """
        self._buffer += data
        while len(self._buffer) >= LEAST_BYTES:
            frame = ProbeFrame.decode(self._buffer)
            if frame is None:
                raise ValueError("not frames of a link probe")
            if len(self._buffer) < frame.size:
                return
            self._buffer = self._buffer[frame.size :]
            yield frame


class ProbeServer:
    """Answers frames at sockets.

    Args:
        sources: bound sockets of datagrams, over Zenoh too, and sockets that listen.
    """

    def __init__(self, *sources: socket.socket) -> None:
        self._sources = sources
        self._streams: dict[socket.socket, FrameStream] = {}
        self._arrivals: dict[int, dict[int, int]] = {}
        self._kernel = own_kernel()

    def run(self, is_stop_requested: Callable[[], bool]) -> None:
        """Answer until it is to stop."""
        while not is_stop_requested():
            sources = [*self._sources, *self._streams]
            for source in select.select(sources, [], [], _POLL_S)[0]:
                with contextlib.suppress(OSError):  # the client is gone
                    self._take(source)
        for near in self._streams:
            near.close()

    def _take(self, source: socket.socket) -> None:
        if source in self._streams:
            self._take_from_stream(source)
        elif source.type == socket.SOCK_DGRAM:
            data, address = source.recvfrom(MOST_BYTES)
            frame, now_ns = ProbeFrame.decode(data), time.monotonic_ns()
            if frame is not None and frame.size == len(data):
                answer = self._answer(frame, now_ns)
                if address is None:  # over Zenoh, where answers go to all clients
                    source.sendall(answer)
                else:
                    source.sendto(answer, address)
        else:
            near, _ = source.accept()
            near.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            self._streams[near] = FrameStream()

    def _take_from_stream(self, source: socket.socket) -> None:
        try:
            data, now_ns = source.recv(MOST_BYTES), time.monotonic_ns()
            if not data:
                raise ValueError("the end")
            for frame in self._streams[source].cut(data):
                source.sendall(self._answer(frame, now_ns))
        except (OSError, ValueError):
            del self._streams[source]
            source.close()

    def _answer(self, frame: ProbeFrame, now_ns: int) -> bytes:
        arrivals = self._arrivals.setdefault(frame.session, {})
        arrivals.setdefault(frame.number, now_ns)
        arrivals.pop(frame.number - 4 * REPEATED, None)
        if len(self._arrivals) > _MOST_SESSIONS:
            del self._arrivals[next(iter(self._arrivals))]
        received = tuple(arrivals.get(frame.number - back, 0) for back in range(REPEATED))
        return frame._replace(
            kernel=self._kernel, received_ns=received, answered_ns=time.monotonic_ns()
        ).encode()
