"""Connections that are closed at once, whatever their peers have not read yet."""

from __future__ import annotations

import contextlib
import socket
import struct
from pathlib import Path

_OFF = struct.pack("ii", 0, 0)


def never_linger() -> None:
    """Have no connection of this process wait, when it is closed, until its peer has read all.

    Zenoh asks for ten seconds of that (SO_LINGER). It closes a connection once a peer was not heard
    of for its lease, and where that peer is frozen, receives nothing from anybody meanwhile.
    """
    entries: list[Path] = []
    with contextlib.suppress(OSError):  # no descriptor is left to look with
        entries = list(Path("/dev/fd").iterdir())
    for entry in filter(Path.is_socket, entries):
        with contextlib.suppress(OSError):  # it is closed by now, or only names a socket (O_PATH)
            own = socket.socket(socket.AF_INET, socket.SOCK_STREAM, fileno=int(entry.name))
            try:
                own.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, _OFF)
            finally:
                own.detach()
