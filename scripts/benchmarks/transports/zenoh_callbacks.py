"""Zenoh with callbacks: as `zenoh`, but for them, and for a status and a state on their own."""

from __future__ import annotations

import queue
import threading

from bus_schema.messages import topics
from bus_schema.zenoh.ros_graph import Attachment
from bus_schema.zenoh.session import Delivery, ZenohSession
from deploy.run.network.links import free_ports
from scripts.benchmarks.echo import Messages, TryingTransport

_ATTACHMENT = Attachment(1, 0, bytes(16)).encode()
_DOMAIN = 0


class Near(TryingTransport):
    """The end that asks."""

    def __init__(self, messages: Messages) -> None:
        self.address = f"tcp/127.0.0.1:{free_ports(1)[0]}"
        self._replies: queue.SimpleQueue[Delivery] = queue.SimpleQueue()
        self._session = ZenohSession([self.address], [], low_latency=True)
        carried = {topics.PLANT_STATUS: messages.status, topics.JOINT_STATES: messages.state}
        self._requests = [
            (self._session.publisher(topic.key_expression(_DOMAIN)), payload)
            for topic, payload in carried.items()
        ]
        self._session.subscribe(topics.JOINT_COMMANDS.key_expression(_DOMAIN), self._replies.put)

    def _send(self) -> None:
        for publisher, payload in self._requests:
            publisher.put(payload, _ATTACHMENT)

    def _took(self, timeout_s: float) -> bool:
        try:
            self._replies.get(timeout=timeout_s)
        except queue.Empty:
            return False
        return True

    @staticmethod
    def answer(address: str, messages: Messages) -> None:
        """Answer every state, on the network thread."""
        session = ZenohSession([], [address], low_latency=True)
        publisher = session.publisher(topics.JOINT_COMMANDS.key_expression(_DOMAIN))
        session.subscribe(topics.PLANT_STATUS.key_expression(_DOMAIN), lambda _: None)
        session.subscribe(
            topics.JOINT_STATES.key_expression(_DOMAIN),
            lambda _: publisher.put(messages.command, _ATTACHMENT),
        )
        threading.Event().wait()
