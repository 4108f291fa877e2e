"""Zenoh as in `zenoh`, under mutual TLS and with access control, as with link.security."""

from __future__ import annotations

import shutil
import tempfile
from pathlib import Path

from bus_schema.link.key_files import KeyFolder
from bus_schema.messages.topics import Role
from bus_schema.zenoh.access import secure_settings
from deploy.benchmarks.echo import Messages
from deploy.benchmarks.transports import zenoh
from deploy.processes.network.keys import create_authority, issue

_DOMAIN = 0
_DAYS = 1.0


class Near(zenoh.Near):
    """The end that asks, and makes the keys."""

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


def answer(address: str, messages: Messages) -> None:
    """Answer every state, as the controller."""
    endpoint, folder = address.split(" ", maxsplit=1)
    keys = KeyFolder(Path(folder))
    zenoh.answer(endpoint, messages, secure_settings(Role.CONTROLLER, _DOMAIN, keys))
