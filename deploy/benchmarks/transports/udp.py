"""Raw UDP sockets on the loopback interface: as little as there can be between two processes."""

from __future__ import annotations

import socket

from deploy.benchmarks.echo import TIMEOUT_S, Messages

_LARGEST = 65_536


class Near:
    """The end that asks."""

    def __init__(self, messages: Messages) -> None:
        self._messages = messages
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.bind(("127.0.0.1", 0))
        self._socket.settimeout(TIMEOUT_S)
        self.address = str(self._socket.getsockname()[1])

    def await_far_end(self) -> None:
        _, far = self._socket.recvfrom(_LARGEST)
        self._socket.connect(far)

    def exchange(self) -> None:
        self._socket.send(self._messages.status)
        self._socket.send(self._messages.state)
        self._socket.recv(_LARGEST)


def answer(address: str, messages: Messages) -> None:
    """Answer every state."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as far:
        far.connect(("127.0.0.1", int(address)))
        far.send(b"here")
        while True:
            if far.recv(_LARGEST) == messages.state:
                far.send(messages.command)
