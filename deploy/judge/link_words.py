"""Words for what a link is configured to do to messages."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from bus_schema.link.channel_configuration import ChannelConfiguration
from bus_schema.link.configuration import LinkConfiguration

_KINDS: dict[str, Callable[[ChannelConfiguration], object]] = {
    "a pattern of delay": lambda way: way.pattern,
    "jitter": lambda way: way.jitter_ms,
    "losses": lambda way: way.loss or way.burst_loss,
    "a limited bandwidth": lambda way: way.rate_kbit_s,
    "scheduled changes": lambda way: way.schedule,
}


def link_words(link: LinkConfiguration) -> str:
    """Return the round trip of the emulated link, and what else happens to messages.

    Delays of the machine and of a real network come on top.
    """
    ways = (link.uplink, link.downlink)
    delay_ms = sum(way.delay_ms for way in ways)
    networks = dict.fromkeys(Path(way.trace.file).stem for way in ways if way.trace is not None)
    kinds = [name for name, has in _KINDS.items() if any(map(has, ways))]
    parts = [f"network {name}" for name in networks]
    if delay_ms or not (parts or kinds):
        parts.insert(0, f"round trip {delay_ms:g} ms" if delay_ms else "no link delay")
    return ", ".join(parts + kinds)


def has_no_effect(link: LinkConfiguration) -> bool:
    """Whether the emulated link delivers every message at once."""
    return link_words(link) == link_words(LinkConfiguration())
