"""Patterns of a delay, with which a study tests a guarantee or looks for the worst one."""

from __future__ import annotations

import itertools
import json
import math
import random
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from deploy.judge.run_rows import Row
from deploy.scenario.playout import EXPECTED
from deploy.scenario.setup import Setup
from deploy.scenario.yaml_files import override
from deploy.study.cases import Case
from deploy.study.follow_ups.trials import command_of, variant_of, worst_of
from deploy.study.margin_search import MarginSearch
from deploy.study.plants import Variant
from deploy.study.quantities import Quantity
from deploy.study.settings import Setting
from deploy.study.study import rows_by

Pattern = dict[str, Any]
"""A section ``pattern`` of a direction, without its defaults."""

HANDFUL: list[Pattern] = [
    {"shape": "square", "period_ms": 20.0},
    {"shape": "square", "period_ms": 120.0},
    {"shape": "sawtooth", "period_ms": 200.0},
    {"shape": "random", "period_ms": 20.0},
]
"""Patterns that test a guarantee, which holds by construction, beside bursts and splits."""
_PERIODS = {"square": 9, "sawtooth": 5, "falling": 4, "random": 3, "walk": 3}
"""Number of periods with which the catalogue has each shape."""
_BURSTS: list[Pattern] = [
    {"shape": "square", "period_ms": period_ms, "duty": 0.05} for period_ms in (100.0, 400.0)
]
_LONGEST_MS = 1000.0
_BURST_MS = 4.0
_CHANNELS = ("uplink", "downlink")
_NEIGHBOURS = 10


def catalogue(tick_ms: float) -> list[Pattern]:
    """Return some twenty patterns, with periods from two ticks to a second."""
    periodic: list[Pattern] = [
        {"shape": shape, "period_ms": _whole_ticks(period_ms, tick_ms)}
        for shape, count in _PERIODS.items()
        for period_ms in np.geomspace(2.0 * tick_ms, _LONGEST_MS, count).tolist()
    ]
    return [*periodic, *_BURSTS]


def variants_at_most(tick_ms: float, *, is_thorough: bool) -> int:
    """Return the largest number of patterns and splits that are tried from a start at a value."""
    if is_thorough:
        return len(catalogue(tick_ms)) + _NEIGHBOURS
    return len(HANDFUL) + len(bursts(tick_ms))


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


def bursts(tick_ms: float) -> list[Pattern]:
    """Return bursts of a few messages just after the start, and again every second."""
    burst_ms = _whole_ticks(_BURST_MS, tick_ms)
    period_ms = _whole_ticks(_LONGEST_MS, tick_ms)
    # Half a tick more, and earlier, so that rounding moves no message out of the burst.
    duty = round((burst_ms + 0.5 * tick_ms) / period_ms, 9)
    return [
        {"shape": "square", "period_ms": period_ms, "duty": duty,
         "phase_ms": round(period_ms - burst_ms - before_ms, 6)}
        for before_ms in (0.0, 5.0 * burst_ms)
    ]  # fmt: skip


def shaped(start: Variant, pattern: Pattern | None, quantity: Quantity) -> Variant:
    """Return a start with a pattern in all delays of a quantity; None for constant delays."""
    channels = [key.rpartition(".")[0] for key in quantity.keys]
    return replace(
        start,
        overrides=(*start.overrides, *(override(f"{each}.pattern", pattern) for each in channels)),
        columns={**start.columns, "pattern": pattern and json.dumps(pattern)},
    )


def splits(setting: Setting, value: float) -> list[Pattern]:
    """Return splits of a constant round trip between the directions: all, or all whole ticks, in
    one.

    Args:
        setting: the setting.
        value: value of its delay, ms.
    """
    link, tick_ms = setting.base.scenario.link, setting.base.grid.period_ns * 1e-6
    varied = [key.split(".")[1] for key in setting.quantity.keys]
    total_ms = value + sum(getattr(link, each).delay_ms for each in _CHANNELS if each not in varied)
    whole_ms = math.floor(total_ms / tick_ms + 1e-9) * tick_ms  # except for rounding
    uplinks_ms = dict.fromkeys(round(each, 6) for each in (total_ms, whole_ms, 0.0))
    return [{"uplink_ms": up_ms, "downlink_ms": round(total_ms - up_ms, 6)} for up_ms in uplinks_ms]


def divided(start: Variant, split: Pattern, setting: Setting) -> Variant:
    """Return a start with another split of the round trip between the directions."""
    last = list[str]()
    for name in _CHANNELS:
        alone = replace(setting.quantity, keys=(f"link.{name}.delay_ms",), share=1.0)
        last += alone.overrides(split[f"{name}_ms"], running=setting.tags["running"])
    columns = {**start.columns, "pattern": json.dumps(split)}
    return replace(start, columns=columns, last=tuple(last))


@dataclass(kw_only=True)
class PatternSearch(MarginSearch):
    """Search for the value up to which all patterns hold, down from the margin of a constant delay.

    Where a play-out levels all delays, a handful of patterns tests that, with the play-out time of
    the constant delay. Otherwise neighbours of the worst pattern are tried at the last value that
    held.

    Attributes:
        case: the case with this margin.
        at_margin: its scenario with the constant delay of this margin.
        is_thorough: whether to try a catalogue of patterns where the play-out does not level them,
            and all of a handful where it does.
        is_levelled: whether the play-out levels all delays up to it.
        worst_overrides: overrides of the run with the worst pattern, once that is known.
    """

    case: Case
    at_margin: Setup
    is_thorough: bool = True
    is_levelled: bool = False
    worst_overrides: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        self._tick_ms = self.case.setting.base.grid.period_ns * 1e-6
        self._refined: set[int] = set()
        self.is_levelled = self.at_margin.is_levelled
        if self.is_thorough and not self.is_levelled:
            self._add(self._shaped(catalogue(self._tick_ms)))
            return
        handful = HANDFUL if self.is_thorough or not self.is_levelled else HANDFUL[-1:]
        self._add(self._shaped([*handful, *bursts(self._tick_ms)]))
        if self.is_levelled:
            setting, starts = self.case.setting, self.case.variants
            found = splits(setting, self.steps.value(self.steps.limit))
            self._add(divided(start, split, setting) for split in found for start in starts)

    @property
    def variants_at_most(self) -> int:
        near = 0 if self._is_refined else _NEIGHBOURS * len(self.case.variants)
        return super().variants_at_most + near

    @property
    def _is_refined(self) -> bool:
        return self.is_levelled or not self.is_thorough or self.margin in self._refined

    def next(self) -> int | None:
        """Return the value to try next, with more variants if it is the last one that held."""
        steps = super().next()
        if steps is None and self.margin and not self._is_refined:
            steps = self.margin
            self._refined.add(steps)
            worst = worst_of(self.rows[steps])["pattern"]
            near = neighbours(json.loads(worst), f"{worst} {steps}", self._tick_ms)
            self._add(self._shaped(near))
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
        tried = max(self.requested.values(), default=0) // len(starts)
        has_worst = is_over and not holds and self.rows
        return {
            "guaranteed": self.steps.value(limit) if holds else None,
            **(self._condition(constant[0]) if holds else {}),
            "worst_pattern": self._worst() if has_worst else None,
            "patterns": {"tried": tried, "motions": motions if self.is_levelled else None},
        }

    @property
    def _playout_ms(self) -> float:
        return round(1e-6 * self.at_margin.playout_range_ns[1], 6)

    @property
    def _grows(self) -> bool:
        """Whether the play-out time grows with the delay of a running loop."""
        return self.case.setting.tags["running"] and self.at_margin.link.plays_automatically

    def _condition(self, row: Row) -> dict[str, Any]:
        """Return d, for which a guarantee holds, and how to set it where the scenario does not."""
        setting, d_ms = self.case.setting, self._playout_ms
        first_ms, later_ms = (1e-6 * each for each in setting.base.playout_range_ns)
        command, is_own = None, first_ms == later_ms == d_ms
        if not (is_own or self._grows):  # a command would set d from the start
            command = command_of(setting, [*setting.overrides, override(EXPECTED, d_ms)], row)
        return {
            "guaranteed_d_ms": d_ms,
            "scenario_d_ms": round(first_ms, 6),
            "guaranteed_command": command,
        }

    def _worst(self) -> dict[str, Any]:
        """Return the pattern with the smallest margin where patterns begin to lose, or last."""
        steps, setting = self.first_failure or self.margin or 0, self.case.setting
        row, value = worst_of(self.rows[steps]), self.steps.value(steps)
        self.worst_overrides = setting.of(value, variant_of(self, row))
        return {
            "pattern": json.loads(row["pattern"]),
            "margin": self.steps.value(self.margin or 0),
            "value": value,
            "margin_min": row["margin_min"],
            "point": row["point"],
            "seed": row["seed"],
            "command": command_of(setting, self.worst_overrides, row),
        }

    def _shaped(self, patterns: Iterable[Pattern]) -> Iterator[Variant]:
        """Return all starts with each of the patterns."""
        starts, quantity = self.case.variants, self.case.setting.quantity
        for pattern, start in itertools.product(patterns, starts):
            yield shaped(start, pattern, quantity)

    def _add(self, variants: Iterable[Variant]) -> None:
        """Add variants; their numbers follow those of the starts."""
        playout: tuple[str, ...] = ()
        if self.is_levelled and self.at_margin.link.plays_automatically and not self._grows:
            playout = (override(EXPECTED, self._playout_ms),)
        first = len(self.case.variants) + len(self.variants)
        self.variants += [
            replace(each, number=number, overrides=(*each.overrides, *playout))
            for number, each in enumerate(variants, first)
        ]

    def _beyond(self, _failure: int) -> list[int]:
        return []


def _whole_ticks(time_ms: float, tick_ms: float) -> float:
    return round(max(1, round(time_ms / tick_ms)) * tick_ms, 6)
