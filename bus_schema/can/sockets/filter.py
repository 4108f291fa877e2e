"""A multicast group without what its members do not want to hear: the kernel keeps it out."""

from __future__ import annotations

import ctypes
import os
import socket
import struct

_SO_ATTACH_FILTER = 26
_SENT_BY_THIS_MACHINE = 5
"""PACKET_LOOPBACK of linux/if_packet.h: a copy of what this machine sends to a group."""

_INSTRUCTION = struct.Struct("=HBBI")
_LOAD_WORD, _LOAD_HALF, _JUMP_IF_EQUAL, _RETURN = 0x20, 0x28, 0x15, 0x06
_PACKET_TYPE = 0xFFFFF000 + 4
_SOURCE_PORT = 0
"""Where it stands in a datagram, whose header is what the filter gets first."""
_WHOLE = 0xFFFFFFFF


def keep_out(descriptor: int, own_port: int, *, other_machines: bool) -> None:
    """Have the kernel drop what comes from a port of this machine, so that nobody hears himself.

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
