"""Closing of connections without waiting for peers to read the rest."""

from __future__ import annotations

import contextlib
import socket
import struct
from pathlib import Path

_OFF = struct.pack("ii", 0, 0)


def never_linger() -> None:
    """Make all connections of this process close at once, even if peers have not read everything.

    Zenoh sets SO_LINGER to ten seconds. It closes a connection when a peer's lease expires; if that
    peer is frozen, Zenoh receives nothing from any peer while it lingers.
    """
    entries: list[Path] = []
    with contextlib.suppress(OSError):  # no descriptor is left for the listing
        entries = list(Path("/dev/fd").iterdir())
    for entry in filter(Path.is_socket, entries):
        with contextlib.suppress(OSError):  # closed meanwhile, or only a name (O_PATH)
            own = socket.socket(socket.AF_INET, socket.SOCK_STREAM, fileno=int(entry.name))
            try:
                own.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, _OFF)
            finally:
                own.detach()
