"""Report of a tuning: what the search found, and what it is worth where nothing was tuned."""

from __future__ import annotations

import plotly.graph_objects as go

from deploy.reports.figures import style
from deploy.reports.figures.study_figures import DrawnStudy
from deploy.reports.page import Cards, Fact, Page, Panel, ReportHead
from deploy.studies.tune.result import TuneResult
from deploy.studies.tune.tables import (
    AS_SAID,
    BEYOND_ALL,
    tune_headline,
    tune_sentences,
    tune_tables,
)

_HEIGHT_PX = 430


def tune_page(study: DrawnStudy) -> Page[DrawnStudy]:
    """Return the report of a tuning."""
    result = TuneResult.model_validate(study.summary)
    return Page(
        "tuning",
        result.name,
        verdict=ReportHead("mixed", tune_headline(result), tune_sentences(result)),
        facts=[
            Fact("Scenario", result.scenario),
            Fact("Tuned for", AS_SAID[result.goal]),
            Fact("Candidates for each law", f"{result.budget}"),
        ],
        panels=lambda: [
            Panel(
                "Search",
                "tune-history",
                "Best cost so far",
                lambda _: _history(result),
                "Each line begins with the gains of the scenario, or those that the law derives"
                " from the arm. A line that still falls at its end has not converged. Costs of runs"
                " that failed are not drawn.",
            )
        ],
        subject=study,
        results=[Cards(tune_tables(result), "stacked")],
    )


def _history(result: TuneResult) -> go.Figure:
    figure = style.new_figure(_HEIGHT_PX, "candidate", "best cost so far")
    for index, (law, found) in enumerate(result.laws.items()):
        costs = [None if cost is None or cost >= BEYOND_ALL else cost for cost in found.history]
        figure.add_scatter(
            x=list(range(len(costs))), y=costs, name=law, mode="lines", line_shape="hv",
            line_color=style.palette(index),
        )  # fmt: skip
    style.put_legend_on_top(figure, 1 + len(figure.data) // 4)
    return figure
