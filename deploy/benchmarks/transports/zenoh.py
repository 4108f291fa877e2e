"""Zenoh as the real loop uses it: its settings, its inboxes, and attachments as it sends them."""

from __future__ import annotations

import threading
import time
from collections.abc import Mapping
from typing import Any

from bus_schema.messages import topics
from bus_schema.zenoh.ros_graph import Attachment
from bus_schema.zenoh.session import ZenohSession
from deploy.benchmarks.echo import Messages, TryingNearEnd
from deploy.processes.network.free_ports import free_ports

_ATTACHMENT = Attachment(1, 0, bytes(16)).encode()
_DOMAIN = 0
_CAPACITY = 1000
_KNOCK_S = 0.05


class Near(TryingNearEnd):
    """The end that asks."""

    def __init__(
        self, messages: Messages, protocol: str = "tcp", security: Mapping[str, Any] | None = None
    ) -> None:
        self.address = f"{protocol}/127.0.0.1:{free_ports(1)[0]}"
        session = ZenohSession([self.address], [], low_latency=True, security=security)
        self._publisher = session.publisher(topics.JOINT_STATES.key_expression(_DOMAIN))
        self._state, self._beside = messages.state, _ATTACHMENT + messages.status
        self._replies = session.inbox(
            topics.JOINT_COMMANDS.key_expression(_DOMAIN), _CAPACITY, lossless=True
        )
        threading.Thread(target=self._knock, daemon=True).start()

    def _send(self) -> None:
        self._publisher.put(self._state, self._beside)

    def _took(self, timeout_s: float) -> bool:
        give_up_s = time.monotonic() + timeout_s
        while self._replies.wait() is None:
            if time.monotonic() > give_up_s:
                return False
        return True

    def _knock(self) -> None:
        while True:
            time.sleep(_KNOCK_S)
            self._replies.knock()


def answer(address: str, messages: Messages, security: Mapping[str, Any] | None = None) -> None:
    """Answer every state, as the real controller does."""
    session = ZenohSession([], [address], low_latency=True, security=security)
    publisher = session.publisher(topics.JOINT_COMMANDS.key_expression(_DOMAIN))
    states = session.inbox(topics.JOINT_STATES.key_expression(_DOMAIN), _CAPACITY, lossless=False)
    while True:
        if states.wait() is not None:
            publisher.put(messages.command, _ATTACHMENT)
