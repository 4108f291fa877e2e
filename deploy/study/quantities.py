"""What grows until a law loses its bounds: something of the link, or any number of a scenario."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from bus_schema.configuration import ConfigurationError
from bus_schema.errors import did_you_mean
from bus_schema.link.configuration import LinkConfiguration
from controller.reference import sample_positions
from deploy.scenario.setup import Setup
from deploy.scenario.study_keys import SEED, require_effect
from deploy.scenario.uncertainty import number_at, number_keys
from deploy.scenario.yaml_files import override, plain

RAMP_FROM_S, RAMP_FOR_S = 1.0, 2.0
"""When a loop that already runs meets what it is tried with: from then on, and in that time."""

_UNITS = {
    "_rad_s": "rad/s", "_m_s": "m/s", "_nm_s": "", "_per_s": "1/s", "_ms": "ms", "_kg": "kg",
    "_rad": "rad", "_nm": "N m", "_hz": "Hz", "_s": "s", "_m": "m",
}  # fmt: skip
"""Units by the ends of keys, the longer ones first."""

Direction = Literal["both", "uplink", "downlink"]

_OTHER_DIRECTION = {"uplink": "downlink", "downlink": "uplink"}
_CEILING_STEP_S = 1e-4
_AT_A_TIME_S = 0.5
_LATEST_CEILING_S = 5.0


@dataclass(frozen=True)
class Steps:
    """Values of a search, in whole steps from the first one on.

    Attributes:
        origin: where nothing has been done to the loop yet.
        resolution: size of a step.
        first: how many steps the first probe after the origin is away.
        limit: how many steps there are.
        growth: 1 where values grow, −1 where they shrink.
    """

    origin: float
    resolution: float
    first: int
    limit: int
    growth: int = 1

    def value(self, steps: int) -> float:
        return round(self.origin + self.growth * steps * self.resolution, 9)


class Quantity(ABC):
    """Something that can be too much.

    Attributes:
        title: what it is called.
        unit: of its values, empty for none.
        keys: scenario keys that it sets.
        starts_from_own: whether a search begins at the scenario's own value, and not at nothing.
    """

    title: str
    unit: str
    keys: tuple[str, ...]
    starts_from_own = False

    @abstractmethod
    def overrides(self, value: float, *, running: bool) -> list[str]:
        """What to set for a value.

        Args:
            value: of the quantity.
            running: whether it comes gradually, to a loop that already runs.
        """

    @abstractmethod
    def steps(self, resolution: float | None, limit: float | None) -> Steps:
        """The values of a search.

        Args:
            resolution: size of a step; the quantity's own if None.
            limit: the last value; the quantity's own if None.

        Raises:
            ConfigurationError: there are no such values.
        """


@dataclass(frozen=True)
class _LinkTraits:
    title: str
    title_one_way: str
    unit: str
    key: str
    share: float
    """Of a value, what each direction gets where both have some."""
    at_first: float
    """Value that a running loop starts with."""
    resolution: float
    first: float
    limit: float


_LINK = {
    "delay": _LinkTraits("round trip", "delay", "ms", "delay_ms", 0.5, 2.0, 0.5, 1.0, 128.0),
    "jitter": _LinkTraits("jitter each way", "jitter", "ms", "jitter_ms", 1.0, 0.0, 0.5, 1.0, 32.0),
    "loss": _LinkTraits("loss each way", "loss", "", "loss", 1.0, 0.0, 0.005, 0.01, 0.9),
}


class LinkQuantity(Quantity):
    """Delay, jitter or loss.

    Args:
        name: ``delay``, ``jitter`` or ``loss``.
        direction: which way; a delay in both is half of a round trip each.
    """

    def __init__(self, name: str, direction: Direction) -> None:
        self._traits = _LINK[name]
        both = direction == "both"
        self._directions = ("uplink", "downlink") if both else (direction,)
        self._share = self._traits.share if both else 1.0
        one_way = f"{direction} {self._traits.title_one_way}"
        self.title = self._traits.title if both else one_way
        self.unit = self._traits.unit
        self.keys = tuple(f"link.{d}.{self._traits.key}" for d in self._directions)

    def overrides(self, value: float, *, running: bool) -> list[str]:
        share, key = self._share * value, self._traits.key
        if not running:
            return [override(f"link.{d}.{key}", share) for d in self._directions]
        ramp = {"kind": "ramp", "at_s": RAMP_FROM_S, "for_s": RAMP_FOR_S, key: share}
        at_first = self._share * min(value, self._traits.at_first)
        return [
            text
            for d in self._directions
            for text in (override(f"link.{d}.{key}", at_first),
                         override(f"link.{d}.schedule", [ramp]))
        ]  # fmt: skip

    def steps(self, resolution: float | None, limit: float | None) -> Steps:
        size = resolution or self._traits.resolution
        end = self._traits.limit if limit is None else limit
        last = _whole_steps(end, size)
        if last < 1:
            allowed = f"must be at least a step, {size:g} {self.unit}".rstrip()
            raise ConfigurationError("limit", end, f"{allowed}, for {self.title}")
        return Steps(0.0, size, min(max(1, round(self._traits.first / size)), last), last)

    def require_unscheduled(self, link: LinkConfiguration) -> None:
        """Refuse links whose schedule a running loop's would take the place of."""
        for direction in self._directions:
            if getattr(link, direction).schedule:
                key = f"link.{direction}.schedule"
                raise ConfigurationError(key, "given", "must be left out where running is on")


class KeyQuantity(Quantity):
    """A number of the scenario.

    Args:
        key: its dotted key.
        own: the scenario's own value, from where on a search goes.
    """

    starts_from_own = True

    def __init__(self, key: str, own: float) -> None:
        self.title, self.unit, self.keys, self._own = key, _unit(key), (key,), own

    def overrides(self, value: float, *, running: bool) -> list[str]:  # noqa: ARG002 (not on a link)
        return [override(self.title, value)]

    def steps(self, resolution: float | None, limit: float | None) -> Steps:
        for key, given in (("limit", limit), ("resolution", resolution)):
            if given is None:
                raise ConfigurationError(key, None, f"must be given for {self.title}")
        assert limit is not None
        assert resolution is not None
        last = _whole_steps(abs(limit - self._own), resolution)
        if last < 1:
            allowed = f"must be a step or more away from the scenario's own {self._own:g}"
            raise ConfigurationError("limit", limit, allowed)
        growth = 1 if limit > self._own else -1
        return Steps(self._own, resolution, max(1, last // 16), last, growth)


def build_quantity(name: str, direction: Direction, running: bool, base: Setup) -> Quantity:
    """A quantity by its name.

    Args:
        name: ``delay``, ``jitter``, ``loss``, or the dotted key of a number.
        direction: of the link.
        running: whether it comes gradually.
        base: the scenario without it.

    Raises:
        ConfigurationError: there is none, or not for this scenario.
    """
    if name in _LINK:
        quantity = LinkQuantity(name, direction)
        if running:
            quantity.require_unscheduled(base.scenario.link)
            _require_longer_than_ramp(base.scenario.duration_s)
        return quantity
    require_effect({name: None}, {SEED: "as seeds (--seeds)"})
    values: dict[str, Any] = plain(base.scenario)
    own = number_at(values, name)
    if own is None or np.ndim(own):
        allowed = f"must be {', '.join(_LINK)}, or the dotted key of one number of the scenario"
        single = [key for key in number_keys(values) if isinstance(number_at(values, key), float)]
        hint = did_you_mean(name, [*_LINK, *single], alike=0.7)
        raise ConfigurationError("quantity", name, allowed + hint)
    for key, given, wanted in (("direction", direction, "both"), ("running", running, False)):
        if given != wanted:
            raise ConfigurationError(key, given, f"must be left out for {name}: it is of no link")
    return KeyQuantity(name, float(own))


def held_arm_ceiling_ms(setup: Setup) -> float | None:
    """When the error of an arm that is held at its start leaves the funnel, ms.

    No law can start under a longer delay: until the first command acts, one round trip after the
    start, the brakes hold the arm where it is, while reference and funnel move on.

    Args:
        setup: a scenario, of which reference, funnel and start count.

    Returns:
        The time to 0.1 ms; None if it is beyond the end of the run, or 5 s.
    """
    last_s = min(setup.scenario.duration_s, _LATEST_CEILING_S)
    for from_s in np.arange(0.0, last_s, _AT_A_TIME_S):
        times = np.arange(from_s, min(from_s + _AT_A_TIME_S, last_s), _CEILING_STEP_S)
        reference = sample_positions(setup.reference, times, setup.robot.joints)
        error = setup.start_position_rad - reference
        upper, lower = setup.funnel.bounds(times)
        outside = ((error > upper) | (error < lower)).any(axis=1)
        if outside.any():
            return round(1e3 * float(times[np.argmax(outside)]), 1)
    return None


def ceiling_of_value(setup: Setup, direction: Direction) -> float | None:
    """The ceiling of a delay in both directions together, or in one beside that of the other, ms.

    Args:
        setup: a scenario.
        direction: in which the delay is; what the other has in the scenario counts as well.
    """
    ceiling = held_arm_ceiling_ms(setup)
    if ceiling is None or direction == "both":
        return ceiling
    other_ms: float = getattr(setup.scenario.link, _OTHER_DIRECTION[direction]).delay_ms
    return round(max(0.0, ceiling - other_ms), 1)


def _whole_steps(distance: float, size: float) -> int:
    """How many steps fit; one that only rounding keeps out does."""
    return math.floor(distance / size + 1e-9)


def _require_longer_than_ramp(duration_s: float) -> None:
    end_s = RAMP_FROM_S + RAMP_FOR_S
    if duration_s <= end_s:
        allowed = f"must be above {end_s:g} s where running is on: until then it grows"
        raise ConfigurationError("duration_s", duration_s, allowed)


def _unit(key: str) -> str:
    """The unit that the name of a key ends with; empty where it is none or ambiguous."""
    return next((unit for suffix, unit in _UNITS.items() if key.endswith(suffix)), "")
