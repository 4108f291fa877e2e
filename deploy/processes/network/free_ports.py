"""TCP ports to listen at."""

from __future__ import annotations

import contextlib
import socket


def free_ports(number: int) -> list[int]:
    """TCP ports of this machine that nobody uses."""
    with contextlib.ExitStack() as stack:
        listeners = [stack.enter_context(socket.socket()) for _ in range(number)]
        for listener in listeners:
            listener.bind(("127.0.0.1", 0))
        return [listener.getsockname()[1] for listener in listeners]
