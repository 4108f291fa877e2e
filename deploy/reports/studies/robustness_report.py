"""The report of margins over uncertain plants: shares kept, and what lost plants have in common."""

from __future__ import annotations

from functools import partial
from typing import Any

import plotly.graph_objects as go

from deploy.reports.figures.studies import many_runs
from deploy.reports.figures.studies.effects import effects
from deploy.reports.page import Fact, Panel
from deploy.reports.studies.robustness_tables import (
    interval_table,
    interval_text,
    kept_text,
    losses_table,
    robustness_table,
    share_text,
    value_text,
)
from deploy.reports.studies.study_content import Study, StudyContent, Summary
from deploy.reports.studies.study_text import case_name, setting_text
from deploy.reports.verdict import ReportHead

_SHOWN_EFFECTS = 12


def robustness_content(summary: Summary) -> StudyContent:
    """What the report of margins over uncertain plants says."""
    cases = summary["cases"]
    arms = list(dict.fromkeys(case["arm"] for case in cases))
    share = f"{100 * summary['kept_share']:g} %"
    return StudyContent(
        kind=f"margins of {summary['quantity']} over uncertain plants",
        verdict=ReportHead(
            "mixed",
            f"Largest {summary['title']} at which {share} of {summary['plants']} plants are kept",
            [
                f"{case['arm']}, {case_name(case)}: {kept_text(case, summary)}{_there(case)}."
                for case in sorted(cases, key=_kept_up_to, reverse=True)
            ],
        ),
        facts=[
            Fact("Plants", str(summary["plants"])),
            Fact("Plant seed", str(summary["plant_seed"])),
            Fact("Values", ", ".join(value_text(value, summary) for value in summary["values"])),
            Fact("Duration of a run", ", ".join(_durations(summary))),
        ],
        panels=[
            *(_share_panel(arm) for arm in arms),
            *(_loss_panel(index, case) for index, case in enumerate(cases)),
        ],
        results=[robustness_table(summary), interval_table(summary), losses_table(summary)],
        points=[
            (f"{case['arm']}, {case_name(case)}, {value_text(value['value'], summary)}", point)
            for case in cases
            for value in case["values"]
            for point in value["worst_points"]
        ],
        points_title="The worst points of each value, with the command that runs them again",
    )


def _share_panel(arm: str) -> Panel[Study]:
    return Panel(
        arm, f"kept-{arm}", f"Plants of {arm} that kept their bounds",
        partial(_shares, arm=arm),
        "Shares of all plants, with Wilson's 95 % intervals as shades. A click gives the command of"
        " the plant that fared worst there.",
        is_clickable=True,
    )  # fmt: skip


def _shares(study: Study, arm: str) -> go.Figure | None:
    summary = study.summary
    cases = [case for case in summary["cases"] if case["arm"] == arm]
    laws, kinds = (list(dict.fromkeys(map(key, cases))) for key in (_law, setting_text))
    several_laws = len(laws) > 1
    lines = [
        many_runs.Curve(
            case_name(case),
            colour=(laws.index(case["law"]) if several_laws else kinds.index(setting_text(case))),
            dash=kinds.index(setting_text(case)) if several_laws else 0,
            points=[_share_point(study, value) for value in case["values"] if value["total"]],
        )
        for case in cases
    ]
    unit = f" ({summary['unit']})" if summary["unit"] else ""
    figure = many_runs.curves(lines, f"{summary['title']}{unit}", many_runs.PLANTS_KEPT)
    if figure is not None:
        figure.update_yaxes(range=[0.0, 103.0])
    return figure


def _share_point(study: Study, value: dict[str, Any]) -> many_runs.Point:
    return many_runs.Point(
        value["value"], many_runs.share_spread(value), study.rerun(value["worst_points"][0])
    )


def _loss_panel(index: int, case: dict[str, Any]) -> Panel[Study]:
    losses = case["losses"]
    bars = [(one["quantity"], one["effect"]) for one in losses["effects"] or []]

    def draw(_study: Study) -> go.Figure | None:
        return effects(bars[:_SHOWN_EFFECTS], losses["chance_level"] or 0.0)

    return Panel(
        "What lost plants have in common", f"losses-{index}", f"{case['arm']}, {case_name(case)}",
        draw,
        f"{losses['lost_plants']} plants were lost at some value. To the right: they had more of"
        " it. Grey bars lie within what chance alone may give the strongest of all quantities.",
    )  # fmt: skip


def _there(case: dict[str, Any]) -> str:
    """How sure that is: the share where it is, with its interval."""
    at = next((v for v in case["values"] if v["value"] == case["kept_up_to"]), None)
    if at is None:
        return ""
    return f", where {share_text(at)} were kept (95 % interval {interval_text(at)})"


def _durations(summary: Summary) -> list[str]:
    return [f"{arm} {duration:g} s" for arm, duration in summary["duration_s"].items()]


def _kept_up_to(case: dict[str, Any]) -> float:
    return -1.0 if case["kept_up_to"] is None else float(case["kept_up_to"])


def _law(case: dict[str, Any]) -> str:
    return str(case["law"])
