"""Figures of margins."""

from __future__ import annotations

from collections.abc import Sequence

import plotly.graph_objects as go

from deploy.reports.figures import style
from deploy.reports.figures.study_figures import HEIGHT_PX, DrawnStudy
from deploy.reports.studies.case_result import setting_text
from deploy.reports.studies.study_texts import value_title
from deploy.studies.margin.result import MarginCase, MarginResult
from deploy.studies.margin.texts import quoted_text

_FARTHEST_CEILING = 2.5
"""Of the largest margin: a ceiling above this would flatten the bars."""
_CEILING = "held-arm ceiling"
_HEADROOM = 1.1
_MOST_UPRIGHT = 6
"""Bars whose figures have room side by side on a telephone; those of more are turned."""


def margin_bars(study: DrawnStudy, margins: MarginResult, cases: Sequence[MarginCase]) -> go.Figure:
    """Margins as bars by law, side by side by setting, and a dotted line at a ceiling nearby.

    Args:
        study: the study.
        margins: its result.
        cases: its cases of one arm.
    """
    figure = style.new_figure(HEIGHT_PX, y_title=value_title(margins))
    groups = list(dict.fromkeys(map(setting_text, cases)))
    for index, group in enumerate(groups):
        members = [case for case in cases if setting_text(case) == group]
        decided = (c.probe_at(c.first_failure) or c.probe_at(c.margin) for c in members)
        own = [style.palette(place) for place in range(len(members))]
        figure.add_bar(
            x=[style.plain(case.law) for case in members],
            y=[case.best_known or 0.0 for case in members],
            text=[_without_unit(margins, case) for case in members],
            name=group or "as the scenario has it",
            textposition="outside", cliponaxis=False,
            constraintext="none", textangle=0 if len(cases) <= _MOST_UPRIGHT else -90,
            textfont={"size": 10},
            customdata=list(map(study.rerun_worst, decided)), hovertemplate="%{x}: %{text}",
            marker={"color": style.palette(index) if len(groups) > 1 else own},
            showlegend=len(groups) > 1,
        )  # fmt: skip
    figure.update_layout(barmode="group", bargap=0.3, bargroupgap=0.06)
    figure.update_yaxes(rangemode="tozero")
    ceilings = [ceiling for case in cases if (ceiling := case.held_arm_ceiling_ms)]
    highest = max((case.best_known or 0.0 for case in cases), default=0.0)
    if ceilings and min(ceilings) <= _FARTHEST_CEILING * highest:
        figure.add_hline(y=min(ceilings), line=style.DOTTED, name=_CEILING, showlegend=True)
        highest = max(min(ceilings), highest)
        figure.update_yaxes(range=[0.0, _HEADROOM * highest])  # lines do not count for autorange
    shown = [each.name for each in (*figure.data, *figure.layout.shapes) if each.showlegend]
    if shown:
        style.add_legend(figure, shown)
    return figure


def _without_unit(margins: MarginResult, case: MarginCase) -> str:
    """The number to quote of a case, for a bar on an axis that has the unit."""
    unit = f" {margins.unit}"
    return quoted_text(case, margins).removesuffix(unit)
