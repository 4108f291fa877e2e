"""LCM: multicast UDP that does not leave the machine."""

from __future__ import annotations

import os

import lcm

from scripts.benchmarks.echo import Messages, TryingTransport


class Near(TryingTransport):
    """The end that asks."""

    def __init__(self, messages: Messages) -> None:
        self._messages = messages
        self.address = f"udpm://239.255.76.67:{20_000 + os.getpid() % 40_000}?ttl=0"
        self._lcm = lcm.LCM(self.address)
        self._lcm.subscribe("command", lambda _channel, _data: None)

    def _send(self) -> None:
        self._lcm.publish("status", self._messages.status)
        self._lcm.publish("state", self._messages.state)

    def _took(self, timeout_s: float) -> bool:
        return bool(self._lcm.handle_timeout(round(1e3 * timeout_s)))

    @staticmethod
    def answer(address: str, messages: Messages) -> None:
        """Answer every state."""
        far = lcm.LCM(address)
        far.subscribe("status", lambda _channel, _data: None)
        far.subscribe("state", lambda _channel, _data: far.publish("command", messages.command))
        while True:
            far.handle()
