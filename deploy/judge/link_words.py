"""The configured link in a few words: its round trip, and what else happens to messages."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Any

from bus_schema.link.channel_configuration import ChannelConfiguration
from bus_schema.link.configuration import LinkConfiguration
from deploy.scenario.definition import ScenarioConfiguration
from deploy.scenario.referenced_files import DATA_FILES, DIRECTIONS

_KINDS: dict[str, Callable[[ChannelConfiguration], object]] = {
    "a pattern of delay": lambda way: way.pattern,
    "jitter": lambda way: way.jitter_ms,
    "losses": lambda way: way.loss or way.burst_loss,
    "a limited bandwidth": lambda way: way.rate_kbit_s,
    "duplicates": lambda way: way.duplicate,
    "scheduled changes": lambda way: way.schedule,
}
_UNNAMED = "a recorded network"
_RECORDED_TRACES = {DATA_FILES[f"link.{direction}.trace.file"] for direction in DIRECTIONS}
"""Names of traces in a recording."""
_DIGEST = re.compile(r"-[0-9a-f]{8}$")
"""What a copied scenario appends to the names of files."""


def link_words(link: LinkConfiguration, manifest: Mapping[str, Any] = MappingProxyType({})) -> str:
    """Return the round trip of the emulated link, and what else happens to messages.

    Delays of the machine and of a real network come on top.

    Args:
        link: section of the scenario; in a recording, traces have names of its own.
        manifest: of its folder, which has the names that the user gave; empty where there is none.
    """
    ways = (link.uplink, link.downlink)
    delay_ms = sum(way.delay_ms for way in ways)
    networks = dict.fromkeys(
        f"network {network}" if (network := _network(way.trace.file, name, manifest)) else _UNNAMED
        for name, way in zip(DIRECTIONS, ways, strict=True)
        if way.trace is not None
    )
    kinds = [name for name, has in _KINDS.items() if any(map(has, ways))]
    parts = [*networks]
    playout_ms = link.playout_ms if isinstance(link.playout_ms, float) else 0.0
    kinds += [f"play-out {playout_ms:g} ms"] if playout_ms else []
    if delay_ms or not (parts or kinds):
        parts.insert(0, f"round trip {delay_ms:g} ms" if delay_ms else "no link delay")
    return ", ".join(parts + kinds)


def _network(file: str, direction: str, manifest: Mapping[str, Any]) -> str | None:
    """Return the name that the user gave a trace; None where only a recording's is known."""
    section: Any = manifest.get("scenario")
    for key in ("link", direction, "trace", "file"):
        section = section.get(key) if isinstance(section, Mapping) else None
    given = Path(section if isinstance(section, str) else file).stem
    return None if given in _RECORDED_TRACES else _DIGEST.sub("", given)


def has_no_delay(scenario: ScenarioConfiguration) -> bool:
    """Whether the emulated link delivers every message at once, and commands act at once."""
    link, dead_time_ms = scenario.link, scenario.plant.actuator.delay_ms
    is_changed = any(
        way.delay_ms or way.trace is not None or any(has(way) for has in _KINDS.values())
        for way in (link.uplink, link.downlink)
    )
    is_held = isinstance(link.playout_ms, float) and link.playout_ms > 0.0
    return not (is_changed or is_held or dead_time_ms)
