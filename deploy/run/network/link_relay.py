"""A relay that does to the messages of any two programs what the emulated link does to ours.

One thread looks after all sockets. What comes in goes into the channel of its direction, which is
that of the plant's own link, and leaves when it is due.
"""

from __future__ import annotations

import contextlib
import select
import socket
import time
from collections import Counter
from collections.abc import Callable
from typing import Any

import numpy as np

from bus_schema.arrays import percentiles
from bus_schema.link.configuration import LinkConfiguration
from deploy.run.network.relayed_bytes import (
    CHUNK_BYTES,
    Chunk,
    DatagramSink,
    Direction,
    RelayedStream,
)
from plant_emulator.channel.opening import DOWNLINK, UPLINK, answer_ns, open_channel

Address = tuple[str, int]
_LOOK_UP_NS = 100_000_000
"""Interval at which the relay checks for a request to stop."""
_MOST_PEERS = 200
"""`select` takes no more than 1024 sockets."""
_AT_ONCE = 64


class LinkRelay:
    """Passes on what comes in at a socket, and the answers.

    Args:
        listener: a UDP socket, or a TCP socket that listens.
        target: where all is passed on to.
        link: its ``downlink`` is the way to the target, its ``uplink`` the way back.
        seed: of all that is random.
        is_from_robot: the other way round, as the robot itself sends first.

    Attributes:
        begun_ns: instant of the monotonic clock at which the link's traces begin.
    """

    def __init__(
        self, listener: socket.socket, target: Address, link: LinkConfiguration, seed: int, *,
        is_from_robot: bool = False,
    ) -> None:  # fmt: skip
        self._listener, self._target = listener, target
        self._is_datagrams = listener.type == socket.SOCK_DGRAM
        ways = ((link.downlink, DOWNLINK), (link.uplink, UPLINK))
        self._names = ("downlink", "uplink")
        if is_from_robot:
            ways, self._names = ways[::-1], self._names[::-1]
        self._there, self._back = self._directions = tuple(
            Direction(
                open_channel(
                    way if self._is_datagrams else way.model_copy(update={"reorder": False}),
                    seed,
                    stream,
                    answer_ns=answer_ns(link, stream),
                )
            )
            for way, stream in ways
        )
        self._peers: dict[Address, tuple[socket.socket, DatagramSink]] = {}
        self._streams: list[RelayedStream] = []
        self.begun_ns = time.monotonic_ns()
        self._woken, self._waker = socket.socketpair()
        listener.setblocking(False)

    def run(self, is_stop_requested: Callable[[], bool]) -> None:
        """Relay until it is to stop."""
        while not is_stop_requested():
            readable, writable = self._await()
            for direction in self._directions:
                direction.let_go(self._now_ns)
            for stream in self._streams:
                stream.resend(self._now_ns())
                if stream.sink in writable:
                    stream.flush()
                if stream.source in readable and stream.wants_more:
                    stream.take_in(self._now_ns())
            for address, (far, _) in self._peers.items():
                if far in readable:
                    self._take_datagrams(far, self._back, DatagramSink(self._listener, address))
            if self._listener in readable:
                self._take_datagrams(self._listener) if self._is_datagrams else self._accept()
            self._forget_ended()
        for each in (*self._sockets(), self._woken, self._waker):
            each.close()

    def wake(self) -> None:
        """Let `run` look now, from another thread, whether it is to stop."""
        with contextlib.suppress(OSError):  # it has stopped
            self._waker.send(b"\0")

    def counts(self) -> dict[str, Any]:
        """Counts of chunks in both directions; percentiles of their lateness, µs."""
        late: Counter[int] = sum((way.lateness_us for way in self._directions), Counter())
        values, counts = np.array(sorted(late.items()), dtype=np.int64).reshape(-1, 2).T
        channels = {
            name: way.channel.statistics().summary()
            for name, way in zip(self._names, self._directions, strict=True)
        }
        for channel in channels.values():
            channel.pop("curves", None)
        return {
            "chunks": late.total(), "lateness_us": percentiles(values, counts), **channels,
        }  # fmt: skip

    def _now_ns(self) -> int:
        return time.monotonic_ns() - self.begun_ns

    def _await(self) -> tuple[set[socket.socket], set[socket.socket]]:
        """Sockets that can be read and written, once there are any or something is due."""
        reads = [self._listener, self._woken, *(far for far, _ in self._peers.values())]
        reads += [stream.source for stream in self._streams if stream.wants_more]
        writes = [stream.sink for stream in self._streams if stream.is_blocked]
        now_ns = self._now_ns()
        due_ns = min(
            now_ns + _LOOK_UP_NS,
            *(way.channel.next_due_ns for way in self._directions),
            *(stream.resend_ns for stream in self._streams),
        )
        readable, writable, _ = select.select(reads, writes, [], max(due_ns - now_ns, 0) * 1e-9)
        return set(readable), set(writable)

    def _take_datagrams(
        self,
        source: socket.socket,
        direction: Direction | None = None,
        sink: DatagramSink | None = None,
    ) -> None:
        """Put what waits at a socket on its way; from the listener, to the sender's own socket."""
        with contextlib.suppress(OSError):  # nothing more, or no receiver
            for _ in range(_AT_ONCE):
                data, address = source.recvfrom(CHUNK_BYTES)
                way, out = direction or self._there, sink or self._sink_of(address)
                if out is not None:
                    way.channel.send(Chunk(out, data), self._now_ns(), len(data))

    def _sink_of(self, address: Address) -> DatagramSink | None:
        """Return the sink of a peer: a socket of its own, to which its answers come."""
        if address not in self._peers:
            if len(self._peers) >= _MOST_PEERS:
                return None
            far = socket.socket(self._listener.family, socket.SOCK_DGRAM)
            far.setblocking(False)
            far.connect(self._target)
            self._peers[address] = far, DatagramSink(far, None)
        return self._peers[address][1]

    def _accept(self) -> None:
        """Take a connection; if the target does not, it ends."""
        with contextlib.suppress(OSError):
            near, _ = self._listener.accept()
            if len(self._streams) >= 2 * _MOST_PEERS:
                near.close()
                return
            far = socket.socket(self._listener.family, socket.SOCK_STREAM)
            for each in (near, far):
                each.setblocking(False)
                each.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            far.connect_ex(self._target)
            there_ns, back_ns = (way.channel.mean_delay_ns for way in self._directions)
            self._streams += [
                RelayedStream(near, far, self._there, back_ns),
                RelayedStream(far, near, self._back, there_ns),
            ]  # fmt: skip

    def _forget_ended(self) -> None:
        """Close connections of which both directions have ended."""
        for there, back in zip(self._streams[::2], self._streams[1::2], strict=True):
            if there.has_ended and back.has_ended:
                there.source.close()
                there.sink.close()
                self._streams = [each for each in self._streams if each not in (there, back)]

    def _sockets(self) -> list[socket.socket]:
        return [far for far, _ in self._peers.values()] + [each.source for each in self._streams]
