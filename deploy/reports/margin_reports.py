"""Reports of margins: of one arm as it is, and over uncertain plants."""

from __future__ import annotations

from functools import partial
from typing import Any

import plotly.graph_objects as go

from deploy.reports.figures import study_figures
from deploy.reports.figures.study_figures import DrawnStudy
from deploy.reports.page import Cards, Fact, Page, Panel
from deploy.reports.study_tables import (
    case_name,
    ceiling_text,
    furthest,
    headlines,
    held_again,
    interval_table,
    interval_text,
    kept_text,
    losses_table,
    margin_table,
    probe_at,
    robustness_table,
    setting_text,
    share_text,
    value_text,
)
from deploy.reports.tables import ABSENT, Column
from deploy.reports.verdict import ReportHead

_SHOWN_EFFECTS = 12

Summary = dict[str, Any]


def margin_page(study: DrawnStudy) -> Page[DrawnStudy]:
    """The report of margins."""
    summary = study.summary
    arms = _arms(summary)
    return Page(
        f"margins of {summary['quantity']}",
        summary["name"],
        verdict=ReportHead(
            "mixed",
            f"{furthest(summary).capitalize()} {summary['title']} at which the bounds are kept",
            [*headlines(summary), *held_again(summary)],
        ),
        facts=[
            Fact("Resolution", value_text(summary["resolution"], summary)),
            Fact("Last value tried", value_text(summary["limit"], summary)),
            Fact("Starts, × initial offset", ", ".join(f"{o:g}" for o in summary["offsets"])),
            Fact("Duration of a run", _durations(summary)),
            Fact("Held-arm ceiling", _ceilings(summary),
                 "The brakes hold the arm until the first command acts: no law can start under"
                 " more delay."),
        ],
        panels=[panel for arm in arms for panel in _margin_panels(arm)],
        subject=study,
        after=("Results", [Cards([margin_table(summary)], "stacked")]),
        points=[
            (_value_name(case, probe, summary), point, study.rerun(point))
            for case in summary["cases"]
            for probe in case["probes"]
            for point in probe["points"]
        ],
    )  # fmt: skip


def robustness_page(study: DrawnStudy) -> Page[DrawnStudy]:
    """The report of margins over uncertain plants."""
    summary = study.summary
    cases, share = summary["cases"], f"{100 * summary['kept_share']:g} %"
    return Page(
        f"margins of {summary['quantity']} over uncertain plants",
        summary["name"],
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
            Fact("Duration of a run", _durations(summary)),
        ],
        panels=[
            *map(_share_panel, _arms(summary)),
            *(_loss_panel(index, case) for index, case in enumerate(cases)),
        ],
        subject=study,
        after=("Results", [
            Cards([robustness_table(summary), interval_table(summary), losses_table(summary)],
                  "stacked"),
        ]),
        points=[
            (_value_name(case, value, summary), point, study.rerun(point))
            for case in cases
            for value in case["values"]
            for point in value["worst_points"]
        ],
        points_title="The worst points of each value, with the command that runs them again",
    )  # fmt: skip


def _margin_panels(arm: str) -> list[Panel[DrawnStudy]]:
    return [
        Panel(
            arm, f"margins-{arm}", f"Margins on {arm}", partial(_bars, arm=arm),
            "The taller, the more a law takes. A click gives the command of the first value that"
            " failed, from the start that fared worst. Dashed: the held-arm ceiling; no loop can be"
            " started beyond it.",
            is_clickable=True,
        ),
        Panel(
            arm, f"outside-{arm}", study_figures.TICKS_OUTSIDE.title,
            partial(_curves, arm=arm, quantity=study_figures.TICKS_OUTSIDE),
            "Where a line leaves zero, its law loses its bounds. Lines are means of all starts and"
            " seeds, the shades reach from the best run to the worst.",
            is_clickable=True,
        ),
        Panel(
            arm, f"rms-{arm}", study_figures.WORST_RMS.title,
            partial(_curves, arm=arm, quantity=study_figures.WORST_RMS),
            "What precision remains, on a logarithmic scale, with the same shades.",
            is_clickable=True,
        ),
    ]  # fmt: skip


def _share_panel(arm: str) -> Panel[DrawnStudy]:
    return Panel(
        arm, f"kept-{arm}", f"Plants of {arm} that kept their bounds",
        partial(_curves, arm=arm, quantity=study_figures.PLANTS_KEPT),
        "Shares of all plants, with Wilson's 95 % intervals as shades. A click gives the command of"
        " the plant that fared worst there.",
        is_clickable=True,
    )  # fmt: skip


def _loss_panel(index: int, case: Summary) -> Panel[DrawnStudy]:
    losses = case["losses"]
    bars = [(one["quantity"], one["effect"]) for one in losses["effects"] or []]

    def draw(_study: DrawnStudy) -> go.Figure | None:
        return study_figures.effects(bars[:_SHOWN_EFFECTS], losses["chance_level"] or 0.0)

    return Panel(
        "What lost plants have in common", f"losses-{index}", f"{case['arm']}, {case_name(case)}",
        draw,
        f"{losses['lost_plants']} plants were lost at some value. To the right: they had more of"
        " it. Grey bars lie within what chance alone may give the strongest of all quantities.",
    )  # fmt: skip


def _bars(study: DrawnStudy, arm: str) -> go.Figure:
    cases = _cases(study.summary, arm)
    probes = [probe_at(c, c["first_failure"]) or probe_at(c, c["margin"]) for c in cases]
    reruns = [study.rerun(probe["worst_point"]) if probe else "" for probe in probes]
    return study_figures.margin_bars(cases, reruns, _axis(study.summary))


def _curves(study: DrawnStudy, arm: str, quantity: study_figures.StudyQuantity) -> go.Figure | None:
    """A line for each case of an arm: laws by colour, settings by dash; of one law by colour."""
    cases = study.summary["cases"]
    laws = list(dict.fromkeys(case["law"] for case in cases))
    settings = list(dict.fromkeys(map(setting_text, cases)))[::-1]
    lines = []
    for case in _cases(study.summary, arm):
        law, setting = laws.index(case["law"]), settings.index(setting_text(case))
        colour, dash = (law, setting) if len(laws) > 1 else (setting, 0)
        points = [
            study_figures.Point(spread["value"], spread, study.rerun(worst_point))
            for spread, worst_point in _spreads(case)
        ]
        lines.append(study_figures.Curve(case_name(case), colour, dash, points))
    return study_figures.curves(lines, _axis(study.summary), quantity)


def _spreads(case: Summary) -> list[tuple[Summary, str]]:
    """What became of each value that was tried, and the point that fared worst there."""
    if "probes" in case:
        return [(probe, probe["worst_point"]) for probe in case["probes"]]
    return [
        ({**value, **study_figures.share_spread(value)}, value["worst_points"][0])
        for value in case["values"]
        if value["total"]
    ]


def _axis(summary: Summary) -> str:
    return Column(summary["title"], summary["unit"]).title


def _ceilings(summary: Summary) -> str:
    """The longest delay under which each arm can be started at all."""
    found = {
        arm: next(filter(None, map(ceiling_text, _cases(summary, arm))), None)
        for arm in _arms(summary)
    }
    return ", ".join(f"{arm} {text}" for arm, text in found.items() if text) or ABSENT


def _there(case: Summary) -> str:
    """How sure that is: the share where it is, with its interval."""
    at = next((v for v in case["values"] if v["value"] == case["kept_up_to"]), None)
    if at is None:
        return ""
    return f", where {share_text(at)} were kept (95 % interval {interval_text(at)})"


def _kept_up_to(case: Summary) -> float:
    return -1.0 if case["kept_up_to"] is None else float(case["kept_up_to"])


def _value_name(case: Summary, tried: Summary, summary: Summary) -> str:
    return f"{case['arm']}, {case_name(case)}, {value_text(tried['value'], summary)}"


def _durations(summary: Summary) -> str:
    return ", ".join(f"{arm} {summary['duration_s'][arm]:g} s" for arm in _arms(summary))


def _arms(summary: Summary) -> list[str]:
    return list(dict.fromkeys(case["arm"] for case in summary["cases"]))


def _cases(summary: Summary, arm: str) -> list[Summary]:
    return [case for case in summary["cases"] if case["arm"] == arm]
