"""Keys for tests of secured links."""

from __future__ import annotations

from pathlib import Path

from bus_schema.link.configuration import KeyFolder
from bus_schema.messages.topics import Role
from deploy.run.network.keys import create_authority, issue


def issued_keys(folder: Path, days: float = 1.0, host: str = "127.0.0.1") -> KeyFolder:
    """An authority, and a certificate of each role for a host (this machine), in a folder."""
    keys = KeyFolder.at(folder)
    create_authority(keys, 1)
    for role in Role:
        issue(keys, role, [host], days)
    return keys
