"""Conditions of a direction of the link, which may change during a run."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from typing import NamedTuple, Protocol

from bus_schema.link.channel_configuration import (
    ChangeableConditions,
    ChannelConfiguration,
    Outage,
)
from plant_emulator.channel.pattern import delay_in_pattern_ns

_NS_PER_BYTE_AT_1_KBIT_S = 8e6
_CHAIN = ("p", "r", "loss_in_bad", "loss_in_good")


class Conditions(NamedTuple):
    """Parameters of a channel at an instant.

    Attributes:
        delay_ns: delay of every message.
        jitter_ns: scale of what jitter adds.
        correlation: of what jitter adds to one message and to the next.
        loss: probability of being lost, independent of others.
        p: Gilbert–Elliott chain, probability of going from good to bad.
        r: from bad to good.
        loss_in_bad: probability of being lost in the bad state.
        loss_in_good: in the good state.
        duplicate: probability of coming twice.
        ns_per_byte: time that a byte takes to pass; 0 without a bandwidth limit.
    """

    delay_ns: float = 0.0
    jitter_ns: float = 0.0
    correlation: float = 0.0
    loss: float = 0.0
    p: float = 0.0
    r: float = 1.0
    loss_in_bad: float = 1.0
    loss_in_good: float = 0.0
    duplicate: float = 0.0
    ns_per_byte: float = 0.0

    @property
    def is_random(self) -> bool:
        """Whether random numbers decide about a message."""
        chances = (self.loss, self.p, self.loss_in_good, self.duplicate)
        return self.jitter_ns != 0.0 or any(0.0 < chance < 1.0 for chance in chances)


class ConditionFault(Protocol):
    """A temporary change of a channel's conditions."""

    def is_active(self, now_ns: int) -> bool:
        """Whether the change is active now."""

    def changed(self, conditions: Conditions) -> Conditions:
        """Return the changed conditions."""


class _Change(NamedTuple):
    start_ns: int
    end_ns: int
    target: Conditions


class ConditionsSchedule:
    """The conditions of a channel over a run.

    Args:
        configuration: a section ``link.uplink`` or ``link.downlink``.
        faults: scheduled faults of this direction.
    """

    def __init__(
        self, configuration: ChannelConfiguration, faults: Sequence[ConditionFault] = ()
    ) -> None:
        self._faults, self._pattern = faults, configuration.pattern
        self._settled = target = Conditions(**_given(configuration))
        self._changes: deque[_Change] = deque()
        self._outages: deque[tuple[int, int]] = deque()
        for entry in configuration.schedule:
            start_ns = round(entry.at_s * 1e9)
            if isinstance(entry, Outage):
                self._outages.append((start_ns, start_ns + round(entry.for_s * 1e9)))
            else:
                target = target._replace(**_given(entry))
                self._changes.append(_Change(start_ns, round(entry.end_s * 1e9), target))

    def at(self, now_ns: int) -> Conditions:
        """The conditions at `now_ns`, which must not be earlier than asked for before."""
        while self._changes and self._changes[0].end_ns <= now_ns:
            self._settled = self._changes.popleft().target
        conditions = self._settled
        if self._changes and self._changes[0].start_ns < now_ns:
            conditions = _between(conditions, self._changes[0], now_ns)
        while self._outages and self._outages[0][1] <= now_ns:
            self._outages.popleft()
        if self._outages and self._outages[0][0] <= now_ns:
            conditions = conditions._replace(loss=1.0)
        if self._pattern is not None:
            delay_ns = delay_in_pattern_ns(self._pattern, conditions.delay_ns, now_ns)
            conditions = conditions._replace(delay_ns=delay_ns)
        for fault in self._faults:
            if fault.is_active(now_ns):
                conditions = fault.changed(conditions)
        return conditions


def _given(section: ChannelConfiguration | ChangeableConditions) -> dict[str, float]:
    """Return the conditions that a section sets, with their own names and units."""
    given: dict[str, float] = {}
    for key in ChangeableConditions.model_fields:
        value = getattr(section, key)
        if value is None:
            continue
        if key.endswith("_ms"):
            given[key.replace("_ms", "_ns")] = value * 1e6
        elif key == "rate_kbit_s":
            given["ns_per_byte"] = _NS_PER_BYTE_AT_1_KBIT_S / value
        elif key == "burst_loss":
            given |= zip(_CHAIN, value.chain, strict=True)
        else:
            given[key] = value
    if isinstance(section, ChannelConfiguration) and section.distribution == "empirical":
        given["jitter_ns"] = 1e6  # its draws are delays in ms
    return given


def _between(before: Conditions, ramp: _Change, now_ns: int) -> Conditions:
    share = (now_ns - ramp.start_ns) / (ramp.end_ns - ramp.start_ns)
    pairs = zip(before, ramp.target, strict=True)
    return Conditions(*(start + share * (end - start) for start, end in pairs))
