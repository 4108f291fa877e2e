"""Faults of a direction of the link: what becomes of the messages on their way."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Iterable
from typing import Literal

from bus_schema.configuration import ConfigurationError, Positive
from plant_emulator.channel.conditions import Conditions
from plant_emulator.faults.fault import Fault, FaultContext, Share

Direction = Literal["uplink", "downlink"]


class LinkFault(Fault):
    """A fault of messages, which takes a link whose messages the plant can change."""

    def check(self, key: str, context: FaultContext) -> None:
        super().check(key, context)
        if context.no_link_faults is not None:
            raise ConfigurationError(f"{key}.kind", self.kind, context.no_link_faults)


class ChannelFault(LinkFault):
    """Attributes: direction: of the link."""

    direction: Direction

    @abstractmethod
    def changed(self, conditions: Conditions) -> Conditions:
        """The conditions of the channel while the fault lasts."""


class LinkCut(ChannelFault):
    """Loses every message."""

    kind: Literal["link_cut"]

    def changed(self, conditions: Conditions) -> Conditions:
        return conditions._replace(loss=1.0)


class LinkSlowed(ChannelFault):
    """Attributes: delay_ms: added to the delay of every message."""

    kind: Literal["link_slowed"]
    delay_ms: Positive

    def changed(self, conditions: Conditions) -> Conditions:
        return conditions._replace(delay_ns=conditions.delay_ns + self.delay_ms * 1e6)


class LinkDuplicated(ChannelFault):
    """Attributes: share: probability that a message comes twice."""

    kind: Literal["link_duplicated"]
    share: Share = 1.0

    def changed(self, conditions: Conditions) -> Conditions:
        return conditions._replace(duplicate=max(conditions.duplicate, self.share))


def channel_faults(faults: Iterable[Fault], direction: Direction) -> list[ChannelFault]:
    """The faults of one direction of the link."""
    return [f for f in faults if isinstance(f, ChannelFault) and f.direction == direction]
