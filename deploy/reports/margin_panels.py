"""The report of margins: bars per law, and what happens on the way there and beyond."""

from __future__ import annotations

from typing import Any

import plotly.graph_objects as go

from deploy.reports.figures.study import Bar, Curve, bars, curves
from deploy.reports.page import Panel
from deploy.reports.study_panels import Rerun, StudyPage, Summary, clickable
from deploy.reports.study_text import case_name, held_again, margin_figure, margin_text
from deploy.reports.tables import number

_GROUPS = {None: "as the scenario has it", False: "without compensation", True: "with compensation"}


def margin_page(summary: Summary, rerun: Rerun) -> StudyPage:
    """What the report of margins says."""
    arms = list(dict.fromkeys(case["arm"] for case in summary["cases"]))
    durations = ", ".join(f"{arm} {summary['duration_s'][arm]:g} s" for arm in arms)
    return StudyPage(
        kind=f"margins of {summary['quantity']}",
        level="mixed",
        headline=f"Largest {summary['title']} at which the bounds are kept",
        reasons=[*(_best(summary, arm) for arm in arms), *held_again(summary)],
        tiles=[
            ("Resolution", f"{summary['resolution']:g} {summary['unit']}".rstrip()),
            ("Largest value tried", f"{summary['limit']:g} {summary['unit']}".rstrip()),
            ("Starts, × initial offset", ", ".join(f"{o:g}" for o in summary["offsets"])),
            ("Duration of a run", durations),
        ],
        sections={arm: _panels(summary, arm, rerun) for arm in arms},
        table_title="Margins",
        header=["Law", "Arm", "Margin", "First that failed", "Ticks outside there (%)",
                "Worst joint's RMS at the margin (mrad)", "Held again at"],
        rows=[_row(case, summary) for case in summary["cases"]],
        table_note="A value holds if the bounds are kept from every start with every seed; the"
        " margin is the largest value up to which all that were probed held.",
        points=[
            (f"{case['arm']}, {case_name(case)}, {probe['value']:g} {summary['unit']}", point)
            for case in summary["cases"]
            for probe in case["probes"]
            for point in probe["points"]
        ],
    )  # fmt: skip


def _panels(summary: Summary, arm: str, rerun: Rerun) -> list[Panel[Summary]]:
    axis = f"{summary['title']} ({summary['unit']})".replace(" ()", "")
    outside = _curves(summary, arm, "violation_fraction", rerun)
    rms = _curves(summary, arm, "worst_rms_rad", rerun)
    return [
        clickable(
            f"margins-{arm}", f"Margins on {arm}",
            "The taller, the more a law takes. A click gives the command of the first value that"
            " failed, from the start that fared worst.",
            _bars(summary, arm, axis, rerun),
        ),
        clickable(
            f"outside-{arm}", "Ticks outside the bounds",
            "Where a line leaves zero, its law loses its bounds. Lines are means of all starts and"
            " seeds, the shades reach from the best run to the worst.",
            curves(outside, axis, "ticks outside (%)", 100.0),
        ),
        clickable(
            f"rms-{arm}", "RMS error of the worst joint",
            "What precision remains, on a logarithmic scale, with the same shades.",
            curves(rms, axis, "RMS error (mrad)", 1e3, log=True),
        ),
    ]  # fmt: skip


def _bars(summary: Summary, arm: str, axis: str, rerun: Rerun) -> go.Figure | None:
    shown = []
    for case in _cases(summary, arm):
        probe = _probe(case, case["first_failure"]) or _probe(case, case["margin"])
        command = rerun(probe["worst_point"]) if probe else ""
        text, group = margin_figure(case), _GROUPS[case["compensation"]]  # the axis has the unit
        shown.append(Bar(group, case["law"], case["margin"], text, command))
    return bars(shown, axis)


def _curves(summary: Summary, arm: str, quantity: str, rerun: Rerun) -> list[Curve]:
    laws = list(dict.fromkeys(case["law"] for case in summary["cases"]))
    return [
        Curve(
            name=case_name(case),
            colour=laws.index(case["law"]),
            dash=1 if case["compensation"] is False else 0,
            x=[probe["value"] for probe in case["probes"]],
            spreads=[probe[quantity] for probe in case["probes"]],
            reruns=[rerun(probe["worst_point"]) for probe in case["probes"]],
        )
        for case in _cases(summary, arm)
    ]


def _row(case: dict[str, Any], summary: Summary) -> list[str]:
    failed, last = _probe(case, case["first_failure"]), _probe(case, case["margin"])
    return [
        case_name(case), case["arm"], margin_text(case, summary), number(case["first_failure"]),
        number(failed["violation_fraction"]["mean"] if failed else None, 100.0),
        number(last["worst_rms_rad"]["mean"] if last else None, 1e3),
        ", ".join(f"{value:g}" for value in case["held_again"]) or "–",
    ]  # fmt: skip


def _best(summary: Summary, arm: str) -> str:
    """Who takes the most on an arm."""
    known = [case for case in _cases(summary, arm) if case["margin"] is not None]
    if not known:
        return f"{arm}: no law keeps its bounds at all."
    best = max(known, key=lambda case: case["margin"])
    others = [case_name(case) for case in known if case["margin"] == best["margin"]]
    return f"{arm}: the largest margin is {margin_text(best, summary)}, of {' and '.join(others)}."


def _cases(summary: Summary, arm: str) -> list[dict[str, Any]]:
    return [case for case in summary["cases"] if case["arm"] == arm]


def _probe(case: dict[str, Any], value: float | None) -> dict[str, Any] | None:
    return next((probe for probe in case["probes"] if probe["value"] == value), None)
