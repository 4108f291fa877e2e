"""Bare carriers of bytes between two processes: raw UDP, and Zenoh as the real loop uses it."""

from __future__ import annotations

import shutil
import socket
import tempfile
import threading
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from bus_schema.link.configuration import KeyFolder
from bus_schema.messages import topics
from bus_schema.messages.topics import Role
from bus_schema.zenoh.access import secure_settings
from bus_schema.zenoh.ros_graph import Attachment
from bus_schema.zenoh.session import ZenohSession
from deploy.run.network.keys import create_authority, issue
from deploy.run.network.links import free_ports
from scripts.benchmarks.echo import TIMEOUT_S, Messages, Transport, TryingTransport

_LARGEST_DATAGRAM = 65_536
_ATTACHMENT = Attachment(1, 0, bytes(16)).encode()
_DOMAIN = 0
_CAPACITY = 1000
_KNOCK_S = 0.05
_DAYS = 1.0


class RawUdp(Transport):
    """Sockets on the loopback interface: as little as there can be between two processes."""

    def __init__(self, messages: Messages) -> None:
        self._messages = messages
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.bind(("127.0.0.1", 0))
        self._socket.settimeout(TIMEOUT_S)
        self.address = str(self._socket.getsockname()[1])

    def await_far_end(self) -> None:
        _, far = self._socket.recvfrom(_LARGEST_DATAGRAM)
        self._socket.connect(far)

    def exchange(self) -> None:
        self._socket.send(self._messages.status)
        self._socket.send(self._messages.state)
        self._socket.recv(_LARGEST_DATAGRAM)

    @staticmethod
    def answer(address: str, messages: Messages) -> None:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as far:
            far.connect(("127.0.0.1", int(address)))
            far.send(b"here")
            while True:
                if far.recv(_LARGEST_DATAGRAM) == messages.state:
                    far.send(messages.command)


class Zenoh(TryingTransport):
    """Zenoh with the settings, the inboxes and the attachments of the real loop."""

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

    @staticmethod
    def answer(address: str, messages: Messages, security: Mapping[str, Any] | None = None) -> None:
        session = ZenohSession([], [address], low_latency=True, security=security)
        publisher = session.publisher(topics.JOINT_COMMANDS.key_expression(_DOMAIN))
        topic = topics.JOINT_STATES.key_expression(_DOMAIN)
        states = session.inbox(topic, _CAPACITY, lossless=False)
        while True:
            if states.wait() is not None:
                publisher.put(messages.command, _ATTACHMENT)


class SecuredZenoh(Zenoh):
    """Zenoh under mutual TLS and with access control, as with link.security; makes the keys."""

    def __init__(self, messages: Messages) -> None:
        self._keys = KeyFolder(Path(tempfile.mkdtemp()))
        create_authority(self._keys, _DAYS)
        for role in (Role.PLANT, Role.CONTROLLER):
            issue(self._keys, role, ["127.0.0.1"], _DAYS)
        super().__init__(messages, "tls", secure_settings(Role.PLANT, _DOMAIN, self._keys))
        self.address += f" {self._keys.path}"

    def await_far_end(self) -> None:
        super().await_far_end()
        shutil.rmtree(self._keys.path)  # both ends have read their keys

    @staticmethod
    def answer(address: str, messages: Messages, security: Mapping[str, Any] | None = None) -> None:
        endpoint, folder = address.split(" ", maxsplit=1)
        keys = secure_settings(Role.CONTROLLER, _DOMAIN, KeyFolder(Path(folder)))
        Zenoh.answer(endpoint, messages, security or keys)
