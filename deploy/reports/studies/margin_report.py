"""The report of margins: bars per law, and what happens on the way there and beyond."""

from __future__ import annotations

from typing import Any

import plotly.graph_objects as go

from deploy.reports.figures.studies import many_runs
from deploy.reports.page import Fact, Panel
from deploy.reports.studies.study_content import Study, StudyContent, Summary
from deploy.reports.studies.study_tables import (
    furthest,
    held_again,
    margin_figure,
    margin_table,
    margin_text,
    probe_at,
)
from deploy.reports.studies.study_text import case_name, ceiling_text, setting_text
from deploy.reports.tables import ABSENT
from deploy.reports.verdict import ReportHead

_AS_IT_IS = "as the scenario has it"
_CEILING = (
    "The brakes hold the arm until the first command acts: no law can start under more delay."
)


def margin_content(summary: Summary) -> StudyContent:
    """What the report of margins says."""
    arms = list(dict.fromkeys(case["arm"] for case in summary["cases"]))
    durations = ", ".join(f"{arm} {summary['duration_s'][arm]:g} s" for arm in arms)
    return StudyContent(
        kind=f"margins of {summary['quantity']}",
        verdict=ReportHead(
            "mixed",
            f"{furthest(summary).capitalize()} {summary['title']} at which the bounds are kept",
            [*(_best(summary, arm) for arm in arms), *held_again(summary)],
        ),
        facts=[
            Fact("Resolution", f"{summary['resolution']:g} {summary['unit']}".rstrip()),
            Fact("Last value tried", f"{summary['limit']:g} {summary['unit']}".rstrip()),
            Fact("Starts, × initial offset", ", ".join(f"{o:g}" for o in summary["offsets"])),
            Fact("Duration of a run", durations),
            Fact("Held-arm ceiling", _ceilings(summary, arms), _CEILING),
        ],
        panels=[panel for arm in arms for panel in _panels(arm)],
        results=[margin_table(summary)],
        points=[
            (f"{case['arm']}, {case_name(case)}, {probe['value']:g} {summary['unit']}", point)
            for case in summary["cases"]
            for probe in case["probes"]
            for point in probe["points"]
        ],
    )


def _panels(arm: str) -> list[Panel[Study]]:
    return [
        Panel(
            arm, f"margins-{arm}", f"Margins on {arm}",
            lambda study: _bars(study, arm),
            "The taller, the more a law takes. A click gives the command of the first value that"
            " failed, from the start that fared worst. Dashed: the held-arm ceiling; no loop can be"
            " started beyond it.",
            is_clickable=True,
        ),
        Panel(
            arm, f"outside-{arm}", many_runs.TICKS_OUTSIDE.title,
            lambda study: _curves(study, arm, many_runs.TICKS_OUTSIDE),
            "Where a line leaves zero, its law loses its bounds. Lines are means of all starts and"
            " seeds, the shades reach from the best run to the worst.",
            is_clickable=True,
        ),
        Panel(
            arm, f"rms-{arm}", many_runs.WORST_RMS.title,
            lambda study: _curves(study, arm, many_runs.WORST_RMS),
            "What precision remains, on a logarithmic scale, with the same shades.",
            is_clickable=True,
        ),
    ]  # fmt: skip


def _bars(study: Study, arm: str) -> go.Figure | None:
    shown = []
    for case in _cases(study.summary, arm):
        probe = probe_at(case, case["first_failure"]) or probe_at(case, case["margin"])
        command = study.rerun(probe["worst_point"]) if probe else ""
        text, group = margin_figure(case), setting_text(case) or _AS_IT_IS  # the axis has the unit
        shown.append(many_runs.Bar(group, case["law"], case["margin"], text, command))
    ceilings = [case["held_arm_ceiling_ms"] for case in _cases(study.summary, arm)]
    ceiling = min(filter(None, ceilings), default=None)
    return many_runs.bars(shown, _axis(study.summary), ceiling)


def _curves(study: Study, arm: str, quantity: many_runs.StudyQuantity) -> go.Figure | None:
    laws, kinds = (
        list(dict.fromkeys(map(key, study.summary["cases"])))
        for key in (lambda case: case["law"], setting_text)
    )
    lines = [
        many_runs.Curve(
            case_name(case),
            colour=laws.index(case["law"]),
            dash=len(kinds) - 1 - kinds.index(setting_text(case)),
            points=[
                many_runs.Point(probe["value"], probe, study.rerun(probe["worst_point"]))
                for probe in case["probes"]
            ],
        )
        for case in _cases(study.summary, arm)
    ]
    return many_runs.curves(lines, _axis(study.summary), quantity)


def _axis(summary: Summary) -> str:
    return f"{summary['title']} ({summary['unit']})" if summary["unit"] else str(summary["title"])


def _ceilings(summary: Summary, arms: list[str]) -> str:
    """The longest delay under which each arm can be started at all."""
    found = {arm: next(filter(None, map(ceiling_text, _cases(summary, arm))), None) for arm in arms}
    return ", ".join(f"{arm} {text}" for arm, text in found.items() if text) or ABSENT


def _best(summary: Summary, arm: str) -> str:
    """Who takes the most on an arm."""
    known = [case for case in _cases(summary, arm) if case["margin"] is not None]
    if not known:
        return f"{arm}: no law keeps its bounds at all."
    best = max(known, key=lambda case: case["growth"] * case["margin"])
    others = [case_name(case) for case in known if case["margin"] == best["margin"]]
    margin = f"{furthest(summary)} margin is {margin_text(best, summary)}"
    return f"{arm}: the {margin}, of {' and '.join(others)}."


def _cases(summary: Summary, arm: str) -> list[dict[str, Any]]:
    return [case for case in summary["cases"] if case["arm"] == arm]
