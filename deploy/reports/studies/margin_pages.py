"""Pages of margins: of one arm as it is, and over uncertain plants."""

from __future__ import annotations

from typing import Any

from deploy.reports.figures import study_figures
from deploy.reports.figures.study_figures import Curve, DrawnStudy, StudyQuantity
from deploy.reports.page import Cards, Fact, Page, Panel
from deploy.reports.studies import study_tables as tables
from deploy.reports.studies import study_texts as texts
from deploy.reports.studies.margin_sentences import (
    brief_margin_sentences,
    margin_headline,
    margin_sentences,
    robustness_sentences,
)
from deploy.reports.tables import ABSENT
from deploy.reports.verdict_texts import ReportHead
from deploy.study.study import starts_text

_SHOWN_EFFECTS = 12
_MOST_NAMED = 8
"""Lines of which each has its entry in the legend; of more, colours and patterns have."""

Summary = dict[str, Any]


def margin_page(study: DrawnStudy) -> Page[DrawnStudy]:
    """The report of margins."""
    summary = study.summary
    arms = _cases_by_arm(summary)
    ceilings = {arm: next(filter(None, map(texts.ceiling_text, arms[arm])), None) for arm in arms}
    return Page(
        f"margins of {summary['quantity']}",
        summary["name"],
        verdict=ReportHead(
            "mixed",
            margin_headline(summary),
            margin_sentences(summary),
            printed=brief_margin_sentences(summary),
        ),
        facts=[
            Fact("Resolution", texts.value_text(summary["resolution"], summary)),
            Fact("Largest value tried", texts.value_text(summary["limit"], summary)),
            Fact("Starts", starts_text(summary)),
            _durations(summary),
            Fact("Held-arm ceiling",
                 ", ".join(f"{arm} {text}" for arm, text in ceilings.items() if text) or ABSENT,
                 "The brakes hold the arm until the first command acts: no law can start with a"
                 " longer delay."),
        ],
        panels=lambda: sorted(
            (panel for arm, cases in arms.items() for panel in _margin_panels(summary, arm, cases)),
            key=lambda panel: panel.section != "Margins",
        ),
        subject=study,
        results=[
            Cards([tables.margin_table(summary), *tables.disturbance_tables(summary),
                   *tables.help_tables(summary)], "stacked")
        ],
        points=[
            (f"{texts.case_title(case)}, worst pattern", worst["point"],
             worst.get("trace_command") or worst["command"])
            for case in summary["cases"]
            if (worst := case.get("worst_pattern"))
        ] + [
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
    best, *others = robustness_sentences(summary)
    explained = [
        f"“Up to” a {summary['title']}: at it and at every smaller one that was tried, at least"
        f" {share} of the plants kept their bounds."
    ]
    if all(case["kept_up_to"] is None for case in cases):
        explained = []
    return Page(
        f"margins of {summary['quantity']} over uncertain plants",
        summary["name"],
        verdict=ReportHead("mixed", best, [*others, *explained]),
        facts=[
            Fact("Plants", str(summary["plants"])),
            Fact("Plant seed", str(summary["plant_seed"])),
            Fact("Values", ", ".join(texts.value_text(v, summary) for v in summary["values"])),
            _durations(summary),
        ],
        panels=lambda: [
            *(_curves_panel(
                summary, arm, own, "kept", study_figures.PLANTS_KEPT,
                "Shares of the tried plants, with 95 % intervals as bars. Click on a point"
                " for the command that repeats its worst plant.",
                f"Plants of {arm} that kept their bounds")
              for arm, own in _cases_by_arm(summary).items()),
            *(_loss_panel(index, case) for index, case in enumerate(cases)),
        ],
        subject=study,
        results=[
            Cards([tables.robustness_table(summary), tables.interval_table(summary),
                   tables.losses_table(summary)], "stacked")
        ],
        points=[
            (_value_name(case, value, summary), point, study.rerun(point))
            for case in cases
            for value in case["values"]
            for point in value["worst_points"]
        ],
        points_title="The worst points of each value, with the command that repeats them",
    )  # fmt: skip


def _margin_panels(summary: Summary, arm: str, cases: list[Summary]) -> list[Panel[DrawnStudy]]:
    return [
        Panel(
            "Margins", f"margins-{arm}", f"Margins on {arm}",
            lambda study: study_figures.margin_bars(study, cases),
            "A taller bar is a larger margin. Click on it for the command that repeats the first"
            " failure, from the worst start. Dotted, if near: the held-arm ceiling, beyond which no"
            " loop can start.",
            is_clickable=True,
        ),
        _curves_panel(
            summary, arm, cases, "outside", study_figures.RUNS_LOST,
            "A law loses its bounds where its line leaves zero. Shares of the runs that were"
            " made: the first loss may decide a value.",
        ),
        _curves_panel(
            summary, arm, cases, "rms", study_figures.WORST_RMS,
            "Error on a logarithmic scale, where no run ended at its loss. Lines are means of all"
            " starts and seeds; shades reach from the best run to the worst.",
        ),
    ]  # fmt: skip


def _curves_panel(
    summary: Summary, arm: str, own: list[Summary], name: str, quantity: StudyQuantity,
    caption: str, title: str = "",
) -> Panel[DrawnStudy]:  # fmt: skip
    """A line for each case of an arm: laws by colour, or of one law its settings.

    Lines are dashed without compensation, and dash-dotted with feedback at the drives. Points
    of loops that already run are hollow.
    """
    laws = list(dict.fromkeys(case["law"] for case in summary["cases"]))
    has_key = len(own) > _MOST_NAMED and len(laws) > 1
    settings = list(dict.fromkeys(map(texts.setting_text, summary["cases"])))
    lines = []
    for case in own:
        law, setting = laws.index(case["law"]), settings.index(texts.setting_text(case))
        dash = (case["compensation"] is False) + 2 * bool(case["drive_feedback"])
        tried = case["probes"] if "probes" in case else case["values"]
        points = [(runs["value"], runs) for runs in tried if runs["runs"]]
        colour = law if len(laws) > 1 else setting
        key = (case["law"], texts.setting_text(case)) if has_key else None
        lines.append(Curve(texts.case_name(case), colour, dash, points, case["running"], key))
    return Panel(
        "Plants" if name == "kept" else arm, f"{name}-{arm}", title or quantity.title,
        lambda study: study_figures.curves(study, lines, texts.value_title(summary), quantity),
        caption, is_clickable=True,
    )  # fmt: skip


def _loss_panel(index: int, case: Summary) -> Panel[DrawnStudy]:
    losses = case["losses"]
    bars = [(one["quantity"], one["effect"]) for one in losses["effects"] or []]
    return Panel(
        "Common properties of lost plants", f"losses-{index}", texts.case_title(case),
        lambda _: study_figures.effects(bars[:_SHOWN_EFFECTS], losses["chance_level"] or 0.0),
        f"{losses['lost_plants']} plants lost their bounds at some value. A bar to the right:"
        " lost plants had larger values of this quantity. Grey bars are within the range of"
        " chance.",
    )  # fmt: skip


def _value_name(case: Summary, tried: Summary, summary: Summary) -> str:
    return f"{texts.case_title(case)}, {texts.value_text(tried['value'], summary)}"


def _durations(summary: Summary) -> Fact:
    durations = summary["duration_s"].items()
    return Fact("Duration of a run", ", ".join(f"{arm} {length:g} s" for arm, length in durations))


def _cases_by_arm(summary: Summary) -> dict[str, list[Summary]]:
    found: dict[str, list[Summary]] = {}
    for case in summary["cases"]:
        found.setdefault(case["arm"], []).append(case)
    return found
