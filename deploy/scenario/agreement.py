"""What of a scenario the processes of a run must have in common, wherever each of them is."""

from __future__ import annotations

import json
import xml.etree.ElementTree as ET
from collections.abc import Iterator, Mapping
from pathlib import PurePath
from types import MappingProxyType
from typing import Any

from bus_schema.link.agreement import Agreement
from deploy.scenario.referenced_files import data_files
from deploy.scenario.setup import Setup
from deploy.scenario.written import effective_values

_OF_EACH_HOST = (
    "link.plant_endpoint", "link.controller_endpoint", "link.router_endpoint",
    "link.security.folder", "link.connect_timeout_s", "link.reply_timeout_s",
    "link.can.interface", "link.can.channel", "link.can.port", "plant.gui",
)  # fmt: skip
"""Keys that may differ: where things are, and how long each waits for them."""


def agreement_of(setup: Setup) -> Agreement:
    """What processes of a run agree on: `values_in_common`, on whatever engine the plant has."""
    values = values_in_common(setup)
    del values["plant.physics.engine"]  # by default it is the one that is installed there
    return Agreement(values)


def values_in_common(
    setup: Setup, recorded: Mapping[str, str] = MappingProxyType({})
) -> dict[str, str]:
    """Every value in force but for those of the host, as JSON; files count by what they hold.

    Args:
        setup: the scenario.
        recorded: texts of files that only a recording holds, by dotted key; others are read.
    """
    values = dict(_leaves(effective_values(setup)))
    for key in _OF_EACH_HOST:
        values.pop(key, None)
    values["robot.urdf"] = _arm(setup.robot.text)
    for key, file in data_files(setup.scenario).items():
        values[key] = recorded[key] if key in recorded else file.read_text(encoding="utf-8")
    return values


def _leaves(values: dict[str, Any], before: str = "") -> Iterator[tuple[str, str]]:
    for name, value in values.items():
        if isinstance(value, dict):
            yield from _leaves(value, f"{before}{name}.")
        else:
            yield f"{before}{name}", json.dumps(value, default=str)


def _arm(urdf: str) -> str:
    """A URDF without what is up to a host or an editor: comments, white space, folders."""
    root = ET.fromstring(urdf)
    for mesh in root.iter("mesh"):
        mesh.set("filename", PurePath(mesh.get("filename", "")).name)
    return ET.canonicalize(ET.tostring(root, encoding="unicode"), strip_text=True)
