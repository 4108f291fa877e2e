"""Findings of a search for a margin, for a summary."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from deploy.judge.run_rows import Row
from deploy.study.cases import Case
from deploy.study.doubts import doubts
from deploy.study.margin_search import MarginSearch
from deploy.study.statistics import badness, in_order, seeds_of, spread_of_runs


def search_findings(search: MarginSearch, case: Case, columns: Mapping[str, str]) -> dict[str, Any]:
    """Return margin, first failure and all tried values of a search, ready for JSON."""
    all_rows = [row for rows in search.rows.values() for row in rows]
    value, others = search.value, _margins_elsewhere(search)
    low, high = search.widest_gap or (0, 0)
    return {
        **search.ends(),
        "widest_gap": round((high - low) * search.steps.resolution, 9),
        "margin_on": {on: value(steps) for on, steps in others.items()},
        "held_again": list(map(value, search.held_again)),
        "seeds": seeds_of(all_rows),
        "doubts": doubts(case.setting, all_rows, columns),
        "probes": [
            {
                "value": value(steps),
                "held": search.outcomes.get(steps),
                "points": sorted({row["point"] for row in rows}),
                "worst_point": max(in_order(rows), key=badness)["point"],
                **spread_of_runs(in_order(rows)),
            }
            for steps, rows in sorted(search.rows.items())
        ],
    }


def _margins_elsewhere(search: MarginSearch) -> dict[str, int | None]:
    """Return the last tried value up to which all were kept, by other physics, in steps."""
    kept = {steps: list(map(_kept_elsewhere, rows)) for steps, rows in sorted(search.rows.items())}
    found: dict[str, int | None] = {}
    for physics in dict.fromkeys(name for rows in kept.values() for row in rows for name in row):
        found[physics] = None
        for steps, rows in kept.items():
            if not all(row.get(physics) for row in rows):
                break
            found[physics] = steps
    return found


def _kept_elsewhere(row: Row) -> dict[str, bool]:
    """Whether a run kept its bounds, by other physics; nothing is known of a failed run."""
    return dict(zip(row.get("confirmed_on") or (), row.get("confirmed_kept") or (), strict=True))
