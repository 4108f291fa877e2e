"""The page of margins."""

from __future__ import annotations

from deploy.reports.figures import study_figures
from deploy.reports.figures.study_figures import DrawnStudy
from deploy.reports.page import Cards, Fact, Page, Panel, ReportHead
from deploy.reports.studies.case_panels import cases_by_arm, curves_panel, durations, value_name
from deploy.reports.studies.case_result import case_title
from deploy.reports.studies.study_texts import ceiling_text, value_text
from deploy.reports.tables import ABSENT
from deploy.studies.margin.figures import margin_bars
from deploy.studies.margin.result import MarginCase, MarginResult
from deploy.studies.margin.sentences import (
    brief_margin_sentences,
    margin_headline,
    margin_sentences,
)
from deploy.studies.margin.tables import (
    disturbance_tables,
    help_tables,
    margin_table,
    margins_by_law,
)
from deploy.study.study import starts_text


def margin_page(study: DrawnStudy) -> Page[DrawnStudy]:
    """The report of margins."""
    summary = MarginResult.model_validate(study.summary)
    arms = cases_by_arm(summary)
    ceilings = {arm: next(filter(None, map(ceiling_text, arms[arm])), None) for arm in arms}
    return Page(
        f"margins of {summary.quantity}",
        summary.name,
        verdict=ReportHead(
            "mixed",
            margin_headline(summary),
            margin_sentences(summary),
            printed=brief_margin_sentences(summary),
        ),
        facts=[
            Fact("Resolution", value_text(summary.resolution, summary)),
            Fact("Largest value tried", value_text(summary.limit, summary)),
            Fact("Starts", starts_text(study.summary)),
            durations(summary),
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
        quoted=lambda: margins_by_law(summary),
        results=[
            Cards([margin_table(summary), *disturbance_tables(summary),
                   *help_tables(summary)], "stacked")
        ],
        points=[
            (f"{case_title(case)}, worst pattern", worst.point,
             worst.trace_command or worst.command)
            for case in summary.cases
            if (worst := case.worst_pattern)
        ] + [
            (value_name(case, probe, summary), point, study.rerun(point))
            for case in summary.cases
            for probe in case.probes
            for point in probe.points
        ],
    )  # fmt: skip


def _margin_panels(
    summary: MarginResult, arm: str, cases: list[MarginCase]
) -> list[Panel[DrawnStudy]]:
    return [
        Panel(
            "Margins", f"margins-{arm}", f"Margins on {arm}",
            lambda study: margin_bars(study, summary, cases),
            "A taller bar is a larger margin. Click on it for the command that repeats the first"
            " failure, from the worst start. Dotted, if near: the held-arm ceiling, beyond which no"
            " loop can start.",
            is_clickable=True,
        ),
        curves_panel(
            summary, arm, cases, "outside", study_figures.RUNS_LOST,
            "A law loses its bounds where its line leaves zero. Shares of the runs that were"
            " made: the first loss may decide a value.",
        ),
        curves_panel(
            summary, arm, cases, "rms", study_figures.WORST_RMS,
            "Error on a logarithmic scale, where no run ended at its loss. Lines are means of all"
            " starts and seeds; shades reach from the best run to the worst.",
        ),
    ]  # fmt: skip
