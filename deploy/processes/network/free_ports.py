"""TCP ports to listen at."""

from __future__ import annotations

import contextlib
import random
import socket
from collections import deque

_PORTS = range(20_000, 32_768)
"""Below those that systems give to connections that go out: one of these may be taken again before
whoever it was chosen for listens."""
_ATTEMPTS = 1000
_lately: deque[int] = deque(maxlen=1000)
"""Those chosen last, which nobody listens at perhaps: of two choices the second is another."""


def free_ports(number: int) -> list[int]:
    """TCP ports of this machine that nobody uses, other ones each time.

    Raises:
        OSError: they are not to be found.
    """
    chance = random.SystemRandom()  # a fork continues its parent's common generator
    chosen: list[int] = []
    with contextlib.ExitStack() as stack:
        for _ in range(_ATTEMPTS):
            if len(chosen) == number:
                return chosen
            listener, port = stack.enter_context(socket.socket()), chance.choice(_PORTS)
            if port in _lately:
                continue
            with contextlib.suppress(OSError):
                listener.bind(("127.0.0.1", port))
                chosen.append(port)
                _lately.append(port)
    raise OSError(f"no {number} free TCP ports found from {_PORTS.start} to {_PORTS.stop - 1}")
