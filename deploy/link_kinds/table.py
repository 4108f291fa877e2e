"""The table of kinds of links. Each is imported when a scenario names it: CAN's libraries are slow.

A new kind is one class after `LinkKind` and one line here.
"""

from __future__ import annotations

from typing import Any

from bus_schema.registry import Registry
from deploy.link_kinds.kind import LinkKind

LINK_KINDS: Registry[LinkKind[Any]] = Registry(
    "link.kind",
    {
        "zenoh": "deploy.link_kinds.zenoh:ZenohKind",
        "in_process": "deploy.link_kinds.in_process:InProcessKind",
        "can": "deploy.link_kinds.can:CanKind",
    },
)
