"""Patterns of a delay, with which a study tests a guarantee or looks for the worst one."""

from __future__ import annotations

import itertools
import json
import random
from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from bus_schema.link.configuration import LinkConfiguration
from deploy.judge.run_rows import Row
from deploy.scenario.yaml_files import override
from deploy.study.cases import Case
from deploy.study.follow_ups.trials import command_of, overrides_of, worst_of
from deploy.study.margin_search import MarginSearch
from deploy.study.plants import Variant
from deploy.study.quantities import Quantity
from deploy.study.study import rows_by
from plant_emulator.channel.delay_range import configured_delays_ns, round_trip_ns

Pattern = dict[str, Any]
"""A section ``pattern`` of a direction, without its defaults."""

HANDFUL: list[Pattern] = [
    {"shape": "square", "period_ms": 20.0},
    {"shape": "square", "period_ms": 120.0},
    {"shape": "sawtooth", "period_ms": 200.0},
    {"shape": "random", "period_ms": 20.0},
]
"""Patterns that test a guarantee, which holds by construction."""
_PERIODS = {"square": 9, "sawtooth": 5, "falling": 4, "random": 3, "walk": 3}
"""Number of periods with which the catalogue has each shape."""
_BURSTS: list[Pattern] = [
    {"shape": "square", "period_ms": period_ms, "duty": 0.05} for period_ms in (100.0, 400.0)
]
_LONGEST_MS = 1000.0
_NEIGHBOURS = 10


def catalogue(tick_ms: float) -> list[Pattern]:
    """Return some twenty patterns, with periods from two ticks to a second."""
    periodic: list[Pattern] = [
        {"shape": shape, "period_ms": _whole_ticks(period_ms, tick_ms)}
        for shape, count in _PERIODS.items()
        for period_ms in np.geomspace(2.0 * tick_ms, _LONGEST_MS, count).tolist()
    ]
    return [*periodic, *_BURSTS]


def neighbours(pattern: Pattern, seed: str, tick_ms: float) -> list[Pattern]:
    """Return patterns of half to twice the period, with other phases and duties.

    Args:
        pattern: the pattern.
        seed: the same seed gives the same neighbours.
        tick_ms: period of the loop.
    """
    found, numbers = [], random.Random(seed)
    for _ in range(_NEIGHBOURS):
        longer_ms = pattern["period_ms"] * 2.0 ** numbers.uniform(-1.0, 1.0)
        period_ms = _whole_ticks(min(longer_ms, _LONGEST_MS), tick_ms)
        phase_ms = _whole_ticks(numbers.uniform(0.0, period_ms), tick_ms)
        duty = {"duty": round(numbers.uniform(0.05, 0.95), 2)}
        more = duty if pattern["shape"] == "square" else {}
        found.append({**pattern, "period_ms": period_ms, "phase_ms": phase_ms, **more})
    return found


def shaped(start: Variant, pattern: Pattern | None, number: int, quantity: Quantity) -> Variant:
    """Return a start with a pattern in all delays of a quantity; None for constant delays."""
    channels = [key.rpartition(".")[0] for key in quantity.keys]
    return replace(
        start,
        number=number,
        overrides=(*start.overrides, *(override(f"{each}.pattern", pattern) for each in channels)),
        columns={**start.columns, "pattern": pattern and json.dumps(pattern)},
    )


def levels(link: LinkConfiguration) -> bool:
    """Whether the play-out of a link makes all delays as long as the longest one."""
    up_ns, down_ns = configured_delays_ns(link.uplink), configured_delays_ns(link.downlink)
    return link.plays_automatically or link.playout_ns >= round_trip_ns(up_ns, down_ns, 1.0)


@dataclass(kw_only=True)
class PatternSearch(MarginSearch):
    """Search for the value up to which all patterns hold, down from the margin of a constant delay.

    Where a play-out levels all delays, a handful of patterns tests that. Otherwise neighbours of
    the worst pattern are tried at the last value that held.

    Attributes:
        case: the case with this margin.
        is_levelled: whether the play-out levels all delays up to it.
        worst_overrides: overrides of the run with the worst pattern, once that is known.
    """

    case: Case
    is_levelled: bool
    worst_overrides: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        self._tick_ms = self.case.setting.base.grid.period_ns * 1e-6
        self._refined: set[int] = set()
        self._add(HANDFUL if self.is_levelled else catalogue(self._tick_ms))

    def next(self) -> int | None:
        """Return the value to try next, with more variants if it is the last one that held."""
        steps = super().next()
        if steps is None and self.margin and not (self.is_levelled or self.margin in self._refined):
            steps = self.margin
            self._refined.add(steps)
            worst = worst_of(self.rows[steps])["pattern"]
            self._add(neighbours(json.loads(worst), f"{worst} {steps}", self._tick_ms))
        return steps

    def findings(self, constant: list[Row]) -> dict[str, Any]:
        """Return up to where every pattern holds, guaranteed or found, and the worst pattern.

        Args:
            constant: rows of the constant delay at its margin.
        """
        starts, limit, is_over = self.case.variants, self.steps.limit, self.next() is None
        rows = [*constant, *self.rows.get(limit, ())]
        by_start = rows_by(rows, lambda row: f"{row['offset_scale']} {row['seed']}")
        motions = max(len({row.get("motion") for row in own}) for own in by_start.values())
        holds = is_over and self.is_levelled and motions == 1 and self.outcomes[limit]
        tried = sum(self.requested.values()) // len(starts)
        has_worst = is_over and not holds and self.rows
        return {
            "guaranteed": self.steps.value(limit) if holds else None,
            "worst_pattern": self._worst() if has_worst else None,
            "patterns": {"tried": tried, "motions": motions if self.is_levelled else None},
        }

    def _worst(self) -> dict[str, Any]:
        """Return the pattern with the smallest margin where patterns begin to lose, or last."""
        steps, setting = self.first_failure or self.margin or 0, self.case.setting
        row, value = worst_of(self.rows[steps]), self.steps.value(steps)
        self.worst_overrides = setting.at(value, overrides_of(self, row))
        return {
            "pattern": json.loads(row["pattern"]),
            "margin": self.steps.value(self.margin or 0),
            "value": value,
            "margin_min": row["margin_min"],
            "point": row["point"],
            "seed": row["seed"],
            "command": command_of(setting, self.worst_overrides, row),
        }

    def _add(self, patterns: Iterable[Pattern]) -> None:
        """Add patterns from all starts; their numbers follow those of the starts."""
        starts, quantity = self.case.variants, self.case.setting.quantity
        for pattern, start in itertools.product(patterns, starts):
            number = len(starts) + len(self.variants)
            self.variants.append(shaped(start, pattern, number, quantity))

    def _beyond(self, _failure: int) -> list[int]:
        return []


def _whole_ticks(time_ms: float, tick_ms: float) -> float:
    return round(max(1, round(time_ms / tick_ms)) * tick_ms, 6)
