"""Changes of a case with a margin, each tried at the same few values: remedies, disturbances."""

from __future__ import annotations

import contextlib
import math
import shlex
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

from deploy.judge.run_rows import Row, tolerated
from deploy.scenario.effective import effective_scenario
from deploy.scenario.scenario import load_setup
from deploy.scenario.yaml_files import ScenarioError
from deploy.study.cases import Case
from deploy.study.margin_search import MarginSearch, Steps
from deploy.study.plants import Variant
from deploy.study.settings import Setting
from deploy.study.statistics import in_order
from deploy.study.statistics import worst as largest
from deploy.study.study import rows_by

COLUMN = "change"
"""Column with the name of a change; null for runs of a case as it is."""
Changes = Mapping[str, tuple[str, ...]]
"""Overrides by the name of a change."""


@dataclass(kw_only=True)
class Trials(MarginSearch):
    """Changes of a case, all of them tried from every start at every value.

    Attributes:
        values: the values, in steps.
    """

    values: list[int]

    @property
    def probes_at_most(self) -> int:
        return sum(steps not in self.outcomes for steps in self.values)

    def next(self) -> int | None:
        return next((steps for steps in self.values if steps not in self.outcomes), None)

    def findings(self) -> list[dict[str, Any]]:
        """Return what became of each change at each value, in the order of values, then names."""
        found = list[dict[str, Any]]()
        for steps in filter(self.outcomes.__contains__, self.values):
            for name, rows in rows_by(in_order(self.rows[steps]), lambda row: row[COLUMN]).items():
                worst, held = worst_of(rows), all(map(tolerated, rows))
                tried = {key: worst[key] for key in ("margin_min", "point", "seed")}
                starts = len({row["point"] for row in rows})
                error = {"worst_rms_rad": largest(worst["rms_rad"]), "starts": starts}
                found.append({
                    COLUMN: name, "value": self.steps.value(steps), "held": held, **tried, **error
                })  # fmt: skip
        return found


def trials(case: Case, steps: Steps, values: list[int], changes: Changes, at: int) -> Trials:
    """Return the trials of the changes that a case accepts and that change it.

    Args:
        case: the case.
        steps: of its search.
        values: the values, in these steps.
        changes: the changes.
        at: number of the first variant.
    """
    setting, value, variants = case.setting, steps.value(values[0]), list[Variant]()
    own = effective_scenario(load_setup(setting.scenario, setting.at(value)))
    for name, overrides in changes.items():
        with contextlib.suppress(ScenarioError):
            setup = load_setup(setting.scenario, setting.at(value, overrides))
            if effective_scenario(setup) != own:
                variants += changed(case, name, overrides, at + len(variants))
    return Trials(steps, variants=variants, values=values if variants else [])


def changed(case: Case, name: str, overrides: tuple[str, ...], at: int) -> list[Variant]:
    """Return the starts of a case with a change, numbered from `at`."""
    return [
        Variant(number, (*start.overrides, *overrides), {**start.columns, COLUMN: name})
        for number, start in enumerate(case.variants, at)
    ]


def worst_of(rows: list[Row]) -> Row:
    """Return the row with the smallest margin, of those that do not hold if there are any."""

    def merit(row: Row) -> tuple[bool, float]:
        return tolerated(row), -math.inf if row["margin_min"] is None else row["margin_min"]

    return min(in_order(rows), key=merit)


def variant_of(search: MarginSearch, row: Row) -> Variant:
    """Return the variant of a row of this search."""
    number = int(row["point"].rpartition("-")[2])
    return next(each for each in search.variants if each.number == number)


def command_of(setting: Setting, overrides: Iterable[str], row: Row) -> str:
    """Return the command that repeats a run of a setting.

    Args:
        setting: the setting.
        overrides: all overrides of the run but its seed; of equal keys the last one counts.
        row: row of the run, for its seed.
    """
    last = dict[str, str]()
    for text in (*overrides, f"seed={row['seed']}"):
        key = text.partition("=")[0]
        last.pop(key, None)  # a section that comes between must not win
        last[key] = text
    words = [word for text in last.values() for word in ("--set", text)]
    return shlex.join(["funnel-hil", "simulate", setting.scenario, *words])
