"""Quantities that grow until a law loses its bounds: of the link, or any number of a scenario."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from bus_schema.configuration import ConfigurationError
from bus_schema.errors import did_you_mean
from bus_schema.units import split_unit
from deploy.scenario.held_arm import Direction
from deploy.scenario.setup import Setup
from deploy.scenario.study_keys import SEED, require_effect
from deploy.scenario.uncertainty import number_at, number_keys
from deploy.scenario.yaml_files import ScenarioError, override, plain
from deploy.study.margin_search import Steps

RAMP_FROM_S, RAMP_FOR_S = 1.0, 2.0
"""Start and duration of the gradual change in a running loop."""
_PULSE_SHARE, _PULSE_S = 0.01, 0.02
"""Share of a joint's largest torque, and duration, of the pulse that excites a running loop."""
EXCITATION = (
    f"running loops: {100 * _PULSE_SHARE:g} % of each joint's largest torque for"
    f" {1e3 * _PULSE_S:g} ms at {RAMP_FROM_S + RAMP_FOR_S:g} s"
)


@dataclass(frozen=True)
class Quantity:
    """A quantity to vary: by default a number of the scenario.

    Attributes:
        title: its name.
        unit: unit of its values, empty for none.
        keys: scenario keys that it sets.
        origin: start of a search: the scenario's own value, or zero for a link.
        is_of_link: whether it is delay, jitter or loss of the link.
        share: each key's share of a value.
        at_first: value that a running loop starts with.
        resolution: size of a step, unless the study gives another one.
        first: the first value tried after the origin; a fraction of the way to the limit if None.
        limit: the last value tried, unless the study gives another one.
    """

    title: str
    unit: str
    keys: tuple[str, ...]
    origin: float = 0.0
    is_of_link: bool = False
    share: float = 1.0
    at_first: float = 0.0
    resolution: float | None = None
    first: float | None = None
    limit: float | None = None

    def overrides(self, value: float, *, running: bool) -> list[str]:
        """Return the overrides for a value.

        Args:
            value: value of the quantity.
            running: whether it grows gradually, in a running loop.
        """
        if not running:
            return [override(key, self.share * value) for key in self.keys]
        texts = []
        for key in self.keys:
            channel, _, name = key.rpartition(".")
            ramp = {"kind": "ramp", "at_s": RAMP_FROM_S, "for_s": RAMP_FOR_S,
                    name: self.share * value}  # fmt: skip
            texts.append(override(key, self.share * min(value, self.at_first)))
            texts.append(override(f"{channel}.schedule", [ramp]))
        return texts

    def steps(self, resolution: float | None, limit: float | None) -> Steps:
        """Return the values of a search.

        Args:
            resolution: size of a step; the quantity's own if None.
            limit: the last value; the quantity's own if None.

        Raises:
            ConfigurationError: there are no such values.
        """
        size = resolution or self.resolution
        end = self.limit if limit is None else limit
        if end is None or size is None:
            missing = "limit" if end is None else "resolution"
            where = f"--{missing}, or {missing} in a study's file"
            raise ScenarioError(f"{where}: must be given for {self.title}")
        growth = -1 if end < self.origin and not self.is_of_link else 1
        last = math.floor(growth * (end - self.origin) / size + 1e-9)  # except for rounding
        if last < 1:
            away = "" if self.is_of_link else f" away from the scenario's own {self.origin:g}"
            allowed = f"must be at least a step, {size:g} {self.unit}".rstrip()
            raise ConfigurationError("limit", end, f"{allowed}{away}, for {self.title}")
        first = last // 16 if self.first is None else round(self.first / size)
        return Steps(self.origin, size, min(max(1, first), last), last, growth)


_LINK = {
    "delay": Quantity(
        "round trip", "ms", ("delay_ms",), is_of_link=True, share=0.5, at_first=2.0,
        resolution=0.5, first=1.0, limit=128.0,
    ),
    "jitter": Quantity(
        "jitter each way", "ms", ("jitter_ms",), is_of_link=True,
        resolution=0.5, first=1.0, limit=32.0,
    ),
    "loss": Quantity(
        "loss each way", "", ("loss",), is_of_link=True,
        resolution=0.005, first=0.01, limit=0.9,
    ),
}  # fmt: skip
"""Quantities of a link in both directions, with a direction's keys. A delay is a round trip.
half of it each way."""


def build_quantity(name: str, direction: Direction, running: bool, base: Setup) -> Quantity:
    """Return a quantity by its name.

    Args:
        name: ``delay``, ``jitter``, ``loss``, or the dotted key of a number.
        direction: direction of the link to vary, or ``both``.
        running: whether it grows gradually.
        base: the scenario without it.

    Raises:
        ConfigurationError: there is none of this name, or not for this scenario.
    """
    if name in _LINK:
        return _link_quantity(name, direction, base if running else None)
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
            raise ConfigurationError(
                key, given, f"must be left out for {name}, which is not a quantity of the link"
            )
    _, unit = split_unit(name)
    return Quantity(name, unit, (name,), float(own))


def _link_quantity(name: str, direction: Direction, running: Setup | None) -> Quantity:
    """Return delay, jitter or loss; `running` is the scenario of a loop in which it grows."""
    quantity, (key,) = _LINK[name], _LINK[name].keys
    if direction == "both":
        channels = ["link.uplink", "link.downlink"]
    else:
        channels = [f"link.{direction}"]
        quantity = replace(quantity, title=f"{direction} {name}", share=1.0)
    if running is not None:
        for channel in channels:
            if getattr(running.scenario.link, channel.removeprefix("link.")).schedule:
                allowed = "must be left out if running is on"
                raise ConfigurationError(f"{channel}.schedule", "given", allowed)
        duration_s, end_s = running.scenario.duration_s, RAMP_FROM_S + RAMP_FOR_S
        if duration_s <= end_s:
            allowed = (
                f"must be above {end_s:g} s if running is on, because the quantity grows until then"
            )
            raise ConfigurationError("duration_s", duration_s, allowed)
    return replace(quantity, keys=tuple(f"{channel}.{key}" for channel in channels))


def excitation(base: Setup) -> tuple[str, ...]:
    """Return the override that pushes each joint of a loop, forwards and backwards in turn."""
    plant = base.scenario.plant
    disturbance, rated_nm = plant.disturbance, plant.actuator.saturation_nm
    if not disturbance.enabled or not disturbance.scale:
        return ()
    rated_nm = base.robot.effort_limits_nm if rated_nm is None else rated_nm
    pushes_nm = np.broadcast_to(_PULSE_SHARE / disturbance.scale * rated_nm, base.robot.joints)
    pushes_nm = pushes_nm * (-1.0) ** np.arange(base.robot.joints)
    when = {"start_s": RAMP_FROM_S + RAMP_FOR_S, "duration_s": _PULSE_S}
    pulses = [
        {"joint": joint, "kind": "pulse", "torque_nm": push_nm, **when}
        for joint, push_nm in zip(base.robot.joint_names, pushes_nm.tolist(), strict=True)
        if math.isfinite(push_nm)
    ]
    terms = [term.model_dump() for term in disturbance.terms]
    return (override("plant.disturbance.terms", [*terms, *pulses]),) if pulses else ()
