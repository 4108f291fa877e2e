"""ZeroMQ: a pair of sockets over TCP."""

from __future__ import annotations

import zmq

from scripts.benchmarks.echo import TIMEOUT_S, Messages, Transport


class Near(Transport):
    """The end that asks."""

    def __init__(self, messages: Messages) -> None:
        self._messages = messages
        self._socket = zmq.Context.instance().socket(zmq.PAIR)
        self._socket.setsockopt(zmq.RCVTIMEO, round(1e3 * TIMEOUT_S))
        self.address = f"tcp://127.0.0.1:{self._socket.bind_to_random_port('tcp://127.0.0.1')}"

    def await_far_end(self) -> None:
        self._socket.recv()

    def exchange(self) -> None:
        self._socket.send(self._messages.status)
        self._socket.send(self._messages.state)
        self._socket.recv()

    @staticmethod
    def answer(address: str, messages: Messages) -> None:
        """Answer every state."""
        far = zmq.Context.instance().socket(zmq.PAIR)
        far.connect(address)
        far.send(b"here")
        while True:
            if far.recv() == messages.state:
                far.send(messages.command)
