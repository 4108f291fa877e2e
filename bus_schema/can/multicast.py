"""CAN frames over UDP multicast, in python-can's wire format, without python-can in the cycle.

A frame is a datagram. All of it but the frame's data is the same whenever a frame of that kind is
sent: such envelopes are made and understood once, by python-can, and kept. What this node sends
comes from a port of its own, by which the kernel keeps its own frames from coming back.
"""

from __future__ import annotations

import ctypes
import os
import select
import socket
import struct
import time
from collections.abc import Callable

from bus_schema.can.frame import CanBus, CanFrame
from bus_schema.errors import BusError

_LONGEST_DATAGRAM = 4096
_MOST_ENVELOPES = 4096
_DATA = b"\xa4data\xc4"
"""The key before a frame's data and the type of its value, as msgpack has them."""
_SEND_TIMEOUT = struct.pack("@ll", 1, 0)

_SO_MEMINFO = 55
_MEMORY = struct.Struct("=9I")
"""SK_MEMINFO_VARS of linux/sock_diag.h; the last one is also the count of SO_RXQ_OVFL."""

_SO_ATTACH_FILTER = 26
_SENT_BY_THIS_MACHINE = 5
"""PACKET_LOOPBACK of linux/if_packet.h: a copy of what this machine sends to a group."""

_INSTRUCTION = struct.Struct("=HBBI")
_LOAD_WORD, _LOAD_HALF, _JUMP_IF_EQUAL, _RETURN = 0x20, 0x28, 0x15, 0x06
_PACKET_TYPE = 0xFFFFF000 + 4
_SOURCE_PORT = 0
"""Its offset in a datagram; the filter sees the header first."""
_WHOLE = 0xFFFFFFFF

Pack = Callable[[CanFrame], bytes]
"""Makes a datagram of a frame; raises `ValueError` for one that the bus does not carry."""

Unpack = Callable[[bytes], CanFrame | None]
"""Makes a frame of a datagram; None if it is none, or none for this bus."""


class Envelopes:
    """Datagrams of frames, of which only the data is new each time.

    Args:
        pack: makes any datagram.
        unpack: understands any datagram.
    """

    def __init__(self, pack: Pack, unpack: Unpack) -> None:
        self._pack, self._unpack = pack, unpack
        self._outgoing: dict[tuple[object, ...], tuple[bytes, bytes]] = {}
        self._incoming: dict[tuple[bytes, bytes], CanFrame] = {}

    def seal(self, frame: CanFrame) -> bytes:
        """The datagram of a frame; raises `ValueError` as `Pack` does."""
        identifier, data, *flags = frame
        kind = (identifier, len(data), *flags)
        envelope = self._outgoing.get(kind)
        if envelope is None:
            datagram = self._pack(frame)
            head, mark, rest = datagram.partition(_DATA)
            envelope = head + mark + rest[:1], rest[1 + len(data) :]
            if len(self._outgoing) < _MOST_ENVELOPES:
                self._outgoing[kind] = envelope
        return envelope[0] + data + envelope[1]

    def open(self, datagram: bytes) -> CanFrame | None:
        """The frame of a datagram, None if it is none."""
        mark = datagram.find(_DATA)
        if mark < 0:
            return None
        start = mark + len(_DATA) + 1
        end = start + datagram[start - 1] if start <= len(datagram) else 0
        envelope = datagram[:start], datagram[end:]
        known = self._incoming.get(envelope)
        if known is not None:
            identifier, _, *flags = known
            return CanFrame(identifier, datagram[start:end], *flags)
        frame = self._unpack(datagram)
        is_typical = frame is not None and frame.data == datagram[start:end]
        if frame is not None and is_typical and len(self._incoming) < _MOST_ENVELOPES:
            self._incoming[envelope] = frame
        return frame


class MulticastBus(CanBus):
    """A node's access to a multicast group, see `CanBus`.

    Args:
        receiver: a socket in the group, which the bus takes over.
        place: group and port.
        hop_limit: reach of frames; with 0 only frames of this machine are received.
        envelopes: datagrams of frames.

    Raises:
        OSError: there is no way to the group.
    """

    def __init__(
        self, receiver: socket.socket, place: tuple[str, int], hop_limit: int, envelopes: Envelopes
    ) -> None:
        self._receiver, self._envelopes = receiver, envelopes
        self._name = place[0]
        self._sender = _sender(receiver.family, place, hop_limit)
        self._sent = self._malformed = 0
        own_port = self._sender.getsockname()[1]
        keep_out(receiver.fileno(), own_port, other_machines=not hop_limit)

    def send(self, frame: CanFrame) -> None:
        """Send a frame.

        Raises:
            BusError: it cannot be sent here, or the network is down.
        """
        try:
            self._sender.send(self._envelopes.seal(frame))
        except (OSError, ValueError) as error:
            raise BusError(f"CAN channel {self._name}: {error}") from error
        self._sent += 1

    def receive(self, timeout_s: float) -> CanFrame | None:
        """The next frame that another node sent; None if none came within `timeout_s`.

        Raises:
            BusError: the network is down.
        """
        give_up_s = time.monotonic() + timeout_s
        try:
            while True:
                datagram = self._next()
                frame = None if datagram is None else self._envelopes.open(datagram)
                self._malformed += datagram is not None and frame is None
                left_s = give_up_s - time.monotonic()
                if frame is not None or left_s <= 0.0:
                    return frame
                if datagram is None:
                    select.select([self._receiver], [], [], left_s)
        except (OSError, ValueError) as error:  # a closed socket's descriptor is -1
            raise BusError(f"CAN channel {self._name}: {error}") from error

    def dropped(self) -> int | None:
        """Frames that came while the socket's queue was full, and datagrams that are no frames.

        None if they are not counted. The kernel also counts those that its filter drops.
        """
        try:
            return max(0, dropped_by_socket(self._receiver.fileno()) - self._sent) + self._malformed
        except OSError:  # another kernel than Linux
            return None

    def close(self) -> None:
        """Leave the bus."""
        self._receiver.close()
        self._sender.close()

    def _next(self) -> bytes | None:
        """A datagram that is there."""
        try:
            return self._receiver.recv(_LONGEST_DATAGRAM)
        except BlockingIOError:
            return None


def _sender(family: int, place: tuple[str, int], hop_limit: int) -> socket.socket:
    sender = socket.socket(family, socket.SOCK_DGRAM)
    try:
        if family == socket.AF_INET6:
            sender.setsockopt(socket.IPPROTO_IPV6, socket.IPV6_MULTICAST_HOPS, hop_limit)
        else:
            sender.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_TTL, hop_limit)
        sender.setsockopt(socket.SOL_SOCKET, socket.SO_SNDTIMEO, _SEND_TIMEOUT)
        sender.connect(place)
    except OSError:
        sender.close()
        raise
    return sender


def dropped_by_socket(descriptor: int) -> int:
    """Number lost since the socket was opened, as its owner read too slowly.

    Those that a filter of the socket keeps out count too.

    Raises:
        OSError: it is no socket, or the kernel has no such count.
    """
    with socket.socket(fileno=os.dup(descriptor)) as receiver:
        memory = receiver.getsockopt(socket.SOL_SOCKET, _SO_MEMINFO, _MEMORY.size)
    dropped: int = _MEMORY.unpack(memory)[-1]
    return dropped


def keep_out(descriptor: int, own_port: int, *, other_machines: bool) -> None:
    """Let the kernel drop frames from a port of this machine: a node must not receive its own.

    Args:
        descriptor: of a socket that is in a multicast group.
        own_port: the port.
        other_machines: drop what comes from these too, and what is sent to the socket alone.

    Raises:
        OSError: it is no socket, or the kernel knows no such filters.
    """
    program = (
        (_LOAD_WORD, 0, 0, _PACKET_TYPE),
        (_JUMP_IF_EQUAL, 0, 3 if other_machines else 2, _SENT_BY_THIS_MACHINE),
        (_LOAD_HALF, 0, 0, _SOURCE_PORT),
        (_JUMP_IF_EQUAL, 1, 0, own_port),
        (_RETURN, 0, 0, _WHOLE),
        (_RETURN, 0, 0, 0),
    )
    instructions = b"".join(_INSTRUCTION.pack(*each) for each in program)
    kept = ctypes.create_string_buffer(instructions)
    with socket.socket(fileno=os.dup(descriptor)) as receiver:
        filter_ = struct.pack("@HP", len(program), ctypes.addressof(kept))
        receiver.setsockopt(socket.SOL_SOCKET, _SO_ATTACH_FILTER, filter_)
