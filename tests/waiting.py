"""Waiting for what another thread or process does, and endpoints that no other test uses."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import TypeVar

from deploy.run.network.links import free_ports

HANG_S = 300.0
"""Longer than anything in a test takes on a slow machine; only a hang lasts so long."""

Found = TypeVar("Found")


def await_true(condition: Callable[[], Found], meaning: str = "a condition") -> Found:
    """Wait until a condition holds; return what it returned."""
    give_up_s = time.monotonic() + HANG_S
    while not (found := condition()):
        assert time.monotonic() < give_up_s, f"waited in vain: {meaning}"
        time.sleep(0.005)
    return found


def free_endpoint() -> str:
    """Return a TCP endpoint that is not in use."""
    return f"tcp/127.0.0.1:{free_ports(1)[0]}"
