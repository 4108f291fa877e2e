"""LCM: multicast UDP that does not leave the machine."""

from __future__ import annotations

import os
import time

import lcm

from deploy.benchmarks.echo import TIMEOUT_S, Messages

_TRY_MS = 50


class Near:
    """The end that asks."""

    def __init__(self, messages: Messages) -> None:
        self._messages = messages
        self.address = f"udpm://239.255.76.67:{20_000 + os.getpid() % 40_000}?ttl=0"
        self._lcm = lcm.LCM(self.address)
        self._lcm.subscribe("command", lambda _channel, _data: None)

    def await_far_end(self) -> None:
        give_up_s = time.monotonic() + TIMEOUT_S
        while not self._try(_TRY_MS):
            if time.monotonic() > give_up_s:
                raise TimeoutError("no multicast between two processes here")
        while self._lcm.handle_timeout(_TRY_MS):
            pass  # late answers to earlier tries

    def exchange(self) -> None:
        if not self._try(round(1e3 * TIMEOUT_S)):
            raise TimeoutError("a message was lost")

    def _try(self, timeout_ms: int) -> bool:
        self._lcm.publish("status", self._messages.status)
        self._lcm.publish("state", self._messages.state)
        return bool(self._lcm.handle_timeout(timeout_ms))


def answer(address: str, messages: Messages) -> None:
    """Answer every state."""
    far = lcm.LCM(address)
    far.subscribe("status", lambda _channel, _data: None)
    far.subscribe("state", lambda _channel, _data: far.publish("command", messages.command))
    while True:
        far.handle()
