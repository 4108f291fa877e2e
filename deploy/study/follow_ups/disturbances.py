"""Disturbances that no play-out levels: lost, late or overtaken messages, also with a bridge."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator
from typing import Annotated, Any

from pydantic import Field

from bus_schema.configuration import Number, Positive, StrictModel, Whole
from deploy.scenario.yaml_files import override, plain
from deploy.study.follow_ups.trials import COLUMN, Changes, Trials
from deploy.study.quantities import RAMP_FOR_S, RAMP_FROM_S
from deploy.study.settings import Setting
from deploy.study.study import rows_by

_FROM_S, _EVERY_S = 0.2, 0.2
"""Time of the first loss, or late message, of a loop that starts; and between two of them."""
_ROUNDING = 1e-9
_CHANNELS = ("uplink", "downlink")
_BRIDGE, _BRIDGED = "controller.delay_compensation.bridge_ms", ", bridge"


class DisturbanceSizes(StrictModel):
    """Sizes of losses and lateness; in both directions, in turn every 0.1 s.

    Attributes:
        lost_in_a_row: most messages lost in a row: first this number, then one less, and so on
            down to 1, then again.
        late_share: share of the messages of each direction that is late.
        late_by_ms: by how much, beyond the delay of the others.
        outage_ms: length of an outage of both directions, once in a run; also of the bridge.
    """

    lost_in_a_row: Annotated[Whole, Field(ge=1, le=100)] = 5
    late_share: Annotated[Number, Field(gt=0, le=0.5)] = 0.01
    late_by_ms: Positive = 20.0
    outage_ms: Positive = 100.0


def changes(sizes: DisturbanceSizes, setting: Setting) -> Changes:
    """Return disturbances of a setting by their names, each without a bridge and with one."""
    base, tick_s = setting.base, 1e-9 * setting.base.grid.period_ns
    from_s = RAMP_FROM_S + RAMP_FOR_S if setting.tags["running"] else _FROM_S
    left_s = base.scenario.duration_s - from_s
    late_s = tick_s * max(1, round(sizes.late_share * _EVERY_S / tick_s))

    def instants(every_s: float) -> Iterator[tuple[int, dict[str, Any]]]:
        for number in range(math.floor(max(0.0, left_s / every_s) + _ROUNDING)):
            for place, direction in ((0.0, "uplink"), (0.5, "downlink")):
                at_s = round(from_s + (number + place) * every_s, 9)
                yield number, {"direction": direction, "at_s": at_s}

    most = sizes.lost_in_a_row
    lost = [
        {"kind": "link_cut", **when, "for_s": tick_s * (most - number % most)}
        for number, when in instants(_EVERY_S)
    ]
    slowed = {"kind": "link_slowed", "delay_ms": sizes.late_by_ms, "for_s": late_s}
    late = [{**slowed, **when} for _, when in instants(late_s / sizes.late_share)]
    once = {"kind": "link_cut", "at_s": from_s + 0.5 * left_s, "for_s": 1e-3 * sizes.outage_ms}
    faults = {
        f"up to {most} lost in a row": lost,
        f"{100 * sizes.late_share:g} % late by {sizes.late_by_ms:g} ms": late,
        f"outage of {sizes.outage_ms:g} ms": [{**once, "direction": each} for each in _CHANNELS],
    }
    own = plain(base.scenario.faults)
    found = {name: [override("faults", [*own, *added])] for name, added in faults.items()}
    each_its_own = {"shape": "random", "period_ms": 1e3 * tick_s}
    found["overtaking, random delays"] = [
        override(f"link.{channel}.{key}", value)
        for channel in _CHANNELS
        for key, value in (("reorder", True), ("pattern", each_its_own))
    ]
    bridges = {"": 0.0, _BRIDGED: sizes.outage_ms}
    return {
        f"{name}{suffix}": (*overrides, override(_BRIDGE, bridge_ms))
        for name, overrides in found.items()
        for suffix, bridge_ms in bridges.items()
    }


def findings(_setting: Setting, trials: Trials) -> list[dict[str, Any]]:
    """Return up to which value each disturbance held, with all smaller ones that were tried."""
    found = []
    for name, tried in rows_by(trials.findings(), lambda row: row[COLUMN]).items():
        held = itertools.takewhile(lambda each: each["held"], reversed(tried))
        found.append({
            "disturbance": name.removesuffix(_BRIDGED),
            "bridge": name.endswith(_BRIDGED),
            "held_up_to": max((each["value"] for each in held), default=None),
            "lost_at": min((each["value"] for each in tried if not each["held"]), default=None),
            "tried": tried,
        })  # fmt: skip
    return found
