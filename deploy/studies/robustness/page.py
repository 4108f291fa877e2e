"""The page of margins over uncertain plants."""

from __future__ import annotations

from deploy.reports.figures import study_figures
from deploy.reports.figures.study_figures import DrawnStudy
from deploy.reports.page import Cards, Fact, Page, Panel, ReportHead
from deploy.reports.studies.case_panels import cases_by_arm, curves_panel, durations, value_name
from deploy.reports.studies.case_result import case_title
from deploy.reports.studies.study_texts import value_text
from deploy.studies.robustness.figures import effects
from deploy.studies.robustness.result import Losses, RobustCase, RobustnessResult
from deploy.studies.robustness.sentences import robustness_sentences
from deploy.studies.robustness.tables import interval_table, losses_table, robustness_table

_SHOWN_EFFECTS = 12


def robustness_page(study: DrawnStudy) -> Page[DrawnStudy]:
    """The report of margins over uncertain plants."""
    summary = RobustnessResult.model_validate(study.summary)
    cases, share = summary.cases, f"{100 * summary.kept_share:g} %"
    best, *others = robustness_sentences(summary)
    explained = [
        f"“Up to” a {summary.title}: at it and at every smaller one that was tried, at least"
        f" {share} of the plants kept their bounds."
    ]
    if all(case.kept_up_to is None for case in cases):
        explained = []
    return Page(
        f"margins of {summary.quantity} over uncertain plants",
        summary.name,
        verdict=ReportHead("mixed", best, [*others, *explained]),
        facts=[
            Fact("Plants", str(summary.plants)),
            Fact("Plant seed", str(summary.plant_seed)),
            Fact("Values", ", ".join(value_text(v, summary) for v in summary.values)),
            durations(summary),
        ],
        panels=lambda: [
            *(curves_panel(
                summary, arm, own, "kept", study_figures.PLANTS_KEPT,
                "Shares of the tried plants, with 95 % intervals as bars. Click on a point"
                " for the command that repeats its worst plant.",
                f"Plants of {arm} that kept their bounds")
              for arm, own in cases_by_arm(summary).items()),
            *(_loss_panel(i, c, c.losses) for i, c in enumerate(cases) if c.losses),
        ],
        subject=study,
        quoted=lambda: robustness_table(summary),
        results=[
            Cards([robustness_table(summary), interval_table(summary),
                   losses_table(summary)], "stacked")
        ],
        points=[
            (value_name(case, value, summary), point, study.rerun(point))
            for case in cases
            for value in case.values
            for point in value.worst_points
        ],
        points_title="The worst points of each value, with the command that repeats them",
    )  # fmt: skip


def _loss_panel(index: int, case: RobustCase, losses: Losses) -> Panel[DrawnStudy]:
    bars = [(one.quantity, one.effect) for one in losses.effects or []]
    return Panel(
        "Common properties of lost plants", f"losses-{index}", case_title(case),
        lambda _: effects(bars[:_SHOWN_EFFECTS], losses.chance_level or 0.0),
        f"{losses.lost_plants} plants lost their bounds at some value. A bar to the right:"
        " lost plants had larger values of this quantity. Grey bars are within the range of"
        " chance.",
    )  # fmt: skip
