"""Bytes on their way through a relay: one direction of it, datagrams, and streams of connections.

Datagrams can be lost, doubled, and overtake each other. A stream of bytes cannot: a chunk that is
lost is sent again some time later, and what came after it waits, as with TCP.
"""

from __future__ import annotations

import contextlib
import socket
from collections import Counter, deque
from collections.abc import Callable
from typing import NamedTuple, Protocol

from plant_emulator.channel.channel import NEVER_NS, Channel

CHUNK_BYTES = 1 << 16
MOST_BYTES = 1 << 22
"""A receiver that does not read holds up its sender beyond so much."""
RESEND_NS = 200_000_000
"""TCP of Linux sends again what was not acknowledged, after so much time or more."""


class Sink(Protocol):
    """Where bytes leave."""

    def pass_on(self, chunk: Chunk) -> None:
        """Send what is due."""


class Chunk(NamedTuple):
    """Bytes on their way.

    Attributes:
        sink: where they leave.
        data: the bytes; empty for the end of a stream.
        number: of a chunk of a stream, from 0.
    """

    sink: Sink
    data: bytes
    number: int = 0


class Direction:
    """One direction of a relay.

    Args:
        channel: what happens to chunks.

    Attributes:
        lateness_us: how much later than due chunks left, each with its count.
    """

    def __init__(self, channel: Channel[Chunk]) -> None:
        self.channel = channel
        self.lateness_us: Counter[int] = Counter()

    def let_go(self, now_ns: Callable[[], int]) -> None:
        """Send on what is due."""
        while self.channel.next_due_ns <= now_ns():
            due_ns, chunk = self.channel.receive()
            chunk.sink.pass_on(chunk)
            self.lateness_us[(now_ns() - due_ns) // 1000] += 1


class DatagramSink:
    """Where datagrams leave to; an address of None is the one that the socket is connected to."""

    def __init__(self, sink: socket.socket, address: tuple[str, int] | None) -> None:
        self._sink, self._address = sink, address

    def pass_on(self, chunk: Chunk) -> None:
        with contextlib.suppress(OSError):  # nobody is there: as on any network, it is gone
            if self._address is None:
                self._sink.send(chunk.data)
            else:
                self._sink.sendto(chunk.data, self._address)


class Stream:
    """One direction of a connection; both sockets do not block.

    Attributes:
        resend_ns: when a chunk that was lost is sent again; `NEVER_NS` if none was.
        has_ended: whether the end was passed on.
    """

    def __init__(self, source: socket.socket, sink: socket.socket, direction: Direction) -> None:
        self.source, self.sink, self._direction = source, sink, direction
        self._waiting: deque[bytes] = deque()  # lost, or behind what was lost
        self._leaving: deque[bytes] = deque()  # due, but the receiver does not read
        self._held_bytes, self._sent, self._passed = 0, 0, 0
        self._is_read_out = self.has_ended = False
        self.resend_ns = NEVER_NS

    @property
    def wants_more(self) -> bool:
        """Whether the source is to be read."""
        return self._held_bytes < MOST_BYTES and not self._is_read_out

    @property
    def is_blocked(self) -> bool:
        """Whether it waits for the receiver to read."""
        return bool(self._leaving)

    def take_in(self, now_ns: int) -> None:
        """Read a chunk; a broken connection ends as one that is closed."""
        try:
            data = self.source.recv(CHUNK_BYTES)
        except BlockingIOError:
            return
        except OSError:
            data = b""
        self._is_read_out = not data
        self._held_bytes += len(data)
        self._waiting.append(data)
        if self.resend_ns == NEVER_NS:
            self.send(now_ns)

    def send(self, now_ns: int) -> None:
        """Put chunks on their way until one is lost."""
        self.resend_ns = NEVER_NS
        while self._waiting:
            data = self._waiting[0]
            if not self._direction.channel.send(Chunk(self, data, self._sent), now_ns, len(data)):
                self.resend_ns = now_ns + RESEND_NS
                return
            self._waiting.popleft()
            self._sent += 1

    def pass_on(self, chunk: Chunk) -> None:
        if chunk.number == self._passed:  # no copy of what was passed on
            self._passed += 1
            self._leaving.append(chunk.data)
            self.flush()

    def flush(self) -> None:
        """Send what the receiver takes; if it is gone, nothing more is read."""
        try:
            while self._leaving:
                data = self._leaving[0]
                if not data:
                    self.sink.shutdown(socket.SHUT_WR)
                    self.has_ended = True
                sent = self.sink.send(data) if data else 0
                self._held_bytes -= sent
                self._leaving[0] = data[sent:]
                if sent == len(data):
                    self._leaving.popleft()
        except BlockingIOError:
            return
        except OSError:
            self._leaving.clear()
            self._is_read_out = self.has_ended = True
