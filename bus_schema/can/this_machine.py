"""A multicast group that hears nobody but this machine."""

from __future__ import annotations

import ctypes
import os
import socket
import struct

_SO_ATTACH_FILTER = 26
_SENT_BY_THIS_MACHINE = 5
"""PACKET_LOOPBACK of linux/if_packet.h: a copy of what this machine sends to a group."""

_LOAD_PACKET_TYPE = struct.pack("=HBBI", 0x20, 0, 0, 0xFFFFF000 + 4)
_NEXT_IF_EQUAL = struct.pack("=HBBI", 0x15, 0, 1, _SENT_BY_THIS_MACHINE)
_ACCEPT = struct.pack("=HBBI", 0x06, 0, 0, 0xFFFFFFFF)
_DROP = struct.pack("=HBBI", 0x06, 0, 0, 0)
_FILTER = (_LOAD_PACKET_TYPE, _NEXT_IF_EQUAL, _ACCEPT, _DROP)


def hear_this_machine_only(descriptor: int) -> None:
    """Have the kernel drop what a socket gets from other machines, and what is sent to it alone.

    Args:
        descriptor: of a socket that is in a multicast group.

    Raises:
        OSError: it is no socket, or the kernel knows no such filters.
    """
    instructions = ctypes.create_string_buffer(b"".join(_FILTER))
    program = struct.pack("@HP", len(_FILTER), ctypes.addressof(instructions))
    with socket.socket(fileno=os.dup(descriptor)) as receiver:
        receiver.setsockopt(socket.SOL_SOCKET, _SO_ATTACH_FILTER, program)
