"""Figures of studies: curves with their spread, bars, and heat maps; every point knows its rerun.

The command that runs a point again is its `customdata`, which the page shows on a click.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import plotly.graph_objects as go

from deploy.reports.figures import style
from deploy.reports.studies.study_texts import (
    probe_at,
    quoted_or_none,
    quoted_text,
    setting_text,
    value_title,
)
from deploy.reports.tables import number, scaled
from deploy.study.study import shown_value

_DASHES = ("solid", "dash", "dashdot", "longdash")  # dots are for limits
_HEAT = [[0.0, "#f3f8fb"], [0.5, "#6aa5cc"], [1.0, "#0b3c5d"]]
_HEIGHT_PX = 430
_FARTHEST_CEILING = 2.5
"""Of the largest margin: a ceiling above this would flatten the bars."""
_HEADROOM = 1.1
_EFFECT_PX, _FRAME_PX = 26, 110
_MOST_UPRIGHT = 6
"""Bars whose figures have room side by side on a telephone; those of more are turned."""


Runs = Mapping[str, Any]
"""Several runs of one point or value, as they stand in a summary."""


class DrawnStudy(NamedTuple):
    """A sweep or margins: the summary, and a function from a point's name to its command."""

    summary: dict[str, Any]
    rerun: Callable[[str], str]

    def rerun_worst(self, runs: Runs | None) -> str:
        """Return the command that repeats the worst of some runs; empty for none."""
        if runs is None:
            return ""
        return self.rerun(runs["worst_point"] if "worst_point" in runs else runs["worst_points"][0])


@dataclass(frozen=True)
class StudyQuantity:
    """What is drawn of several runs.

    Attributes:
        key: of its spread in what `spread_of_runs` says.
        title: of its figures.
        axis: title of its axis, with its unit.
        factor: from the summary's unit to that one.
        is_log: whether its axis is logarithmic.
        more_is_worse: whether large values are bad ones.
        axis_range: from where to where its axis goes; as its values do if None.
    """

    key: str
    title: str
    axis: str
    factor: float
    is_log: bool = False
    more_is_worse: bool = True
    axis_range: tuple[float, float] | None = None

    def value(self, runs: Runs, which: str) -> float | None:
        """Return ``mean``, ``lowest`` or ``highest`` of some runs, in the unit of the axis.

        The share of plants has its interval as spread, that of lost runs has none.
        """
        spread = runs.get(self.key)
        if self is RUNS_LOST:
            spread = {which: 1.0 - runs["runs_kept"] / runs["runs"]}
        if self is PLANTS_KEPT:
            low, high = runs.get("interval_95", runs["wilson_95"]) or (None, None)
            spread = {"mean": runs["fraction"], "lowest": low, "highest": high}
        return scaled(spread[which], self.factor) if spread else None


TICKS_OUTSIDE = StudyQuantity(
    "violation_fraction", "Ticks outside the bounds", "ticks outside (%)", 100.0
)
RUNS_LOST = StudyQuantity("runs_lost", "Runs that lost their bounds", "runs lost (%)", 100.0)
WORST_RMS = StudyQuantity(
    "worst_rms_rad", "RMS error of the worst joint", "RMS error (mrad)", 1e3, is_log=True
)
PLANTS_KEPT = StudyQuantity(
    "kept_share",
    "Plants that kept their bounds",
    "plants kept (%)",
    100.0,
    more_is_worse=False,
    axis_range=(0.0, 103.0),
)


@dataclass(frozen=True)
class Curve:
    """One line over a swept value.

    Attributes:
        name: its name.
        colour: number of its colour.
        dash: number of its dash pattern.
        points: values with their runs.
        is_hollow: whether its points are hollow.
        key: names of its colour and of its pattern, where the legend has these instead.
        is_sequence: whether a line joins its points: not those of windows, seeds or names.
    """

    name: str
    colour: int
    dash: int
    points: Sequence[tuple[Any, Runs]]
    is_hollow: bool = False
    key: tuple[str, str] | None = None
    is_sequence: bool = True


def curves(
    study: DrawnStudy, lines: Sequence[Curve], x_title: str, quantity: StudyQuantity
) -> go.Figure | None:
    """Lines over a swept value, each with its spread from the lowest to the highest run."""
    figure = style.new_figure(_HEIGHT_PX, x_title, quantity.axis)
    for line in lines:
        _add_curve(figure, study, line, quantity)
    if not any(value is not None for trace in figure.data for value in trace.y):
        return None
    style.add_legend(figure, _name_in_legend(figure, lines))
    if quantity.is_log:
        style.log_axis(figure, ticks=4)
    else:
        figure.update_yaxes(rangemode="tozero", range=quantity.axis_range)
    return figure


def margin_bars(study: DrawnStudy, cases: Sequence[dict[str, Any]]) -> go.Figure:
    """Margins as bars by law, side by side by setting, and a dotted line at a ceiling nearby.

    Args:
        study: the study.
        cases: its cases of one arm.
    """
    figure = style.new_figure(_HEIGHT_PX, y_title=value_title(study.summary))
    groups = list(dict.fromkeys(map(setting_text, cases)))
    for index, group in enumerate(groups):
        members = [case for case in cases if setting_text(case) == group]
        decided = (probe_at(c, c["first_failure"]) or probe_at(c, c["margin"]) for c in members)
        own = [style.palette(place) for place in range(len(members))]
        figure.add_bar(
            x=[style.plain(case["law"]) for case in members],
            y=[quoted_or_none(case) or 0.0 for case in members],
            text=[_without_unit(study, case) for case in members],
            name=group or "as the scenario has it",
            textposition="outside", cliponaxis=False,
            constraintext="none", textangle=0 if len(cases) <= _MOST_UPRIGHT else -90,
            textfont={"size": 10},
            customdata=list(map(study.rerun_worst, decided)), hovertemplate="%{x}: %{text}",
            marker={"color": style.palette(index) if len(groups) > 1 else own},
        )  # fmt: skip
    if len(groups) > 1:
        style.add_legend(figure, [bars.name for bars in figure.data])
    figure.update_layout(barmode="group", bargap=0.3, bargroupgap=0.06)
    figure.update_yaxes(rangemode="tozero")
    ceilings = [ceiling for case in cases if (ceiling := case["held_arm_ceiling_ms"])]
    highest = max((quoted_or_none(case) or 0.0 for case in cases), default=0.0)
    if ceilings and min(ceilings) <= _FARTHEST_CEILING * highest:
        figure.add_hline(y=min(ceilings), line=style.DOTTED)
        highest = max(min(ceilings), highest)
        figure.update_yaxes(range=[0.0, _HEADROOM * highest])  # lines do not count for autorange
    return figure


def _without_unit(study: DrawnStudy, case: dict[str, Any]) -> str:
    """The number to quote of a case, for a bar on an axis that has the unit."""
    unit = f" {study.summary['unit']}"
    return quoted_text(case, study.summary).removesuffix(unit).replace("none", "–")


def heat_map(
    study: DrawnStudy,
    x: tuple[str, Sequence[Any]],
    y: tuple[str, Sequence[Any]],
    rows: Sequence[Sequence[Runs | None]],
    quantity: StudyQuantity,
) -> go.Figure:
    """Means over two swept keys.

    Args:
        study: the study.
        x: title and values of the horizontal axis.
        y: title and values of the vertical axis.
        rows: a row per value of `y`; None leaves a field white.
        quantity: what is drawn.
    """
    means = [
        [None if runs is None else quantity.value(runs, "mean") for runs in row] for row in rows
    ]
    texts = [["" if mean is None else number(mean) for mean in row] for row in means]
    crowded = len(x[1]) * len(y[1]) > 150
    field = go.Heatmap(
        x=[style.plain(shown_value(value)) for value in x[1]],
        y=[style.plain(shown_value(value)) for value in y[1]],
        z=means, zmin=0.0, zmax=max((m for row in means for m in row if m), default=1.0),
        customdata=[list(map(study.rerun_worst, row)) for row in rows],
        text=texts, texttemplate=None if crowded else "%{text}",
        colorscale=_HEAT, xgap=1, ygap=1, hoverongaps=False,
        colorbar={"title": {"text": quantity.axis, "side": "right"}, "thickness": 12},
        hovertemplate="%{x} · %{y}: %{text}<extra></extra>",
    )  # fmt: skip
    height_px = 140 + max(240, min(34 * len(y[1]), 600))
    figure = style.new_figure(height_px, x[0], y[0], [field])
    figure.update_xaxes(type="category", showgrid=False)
    return figure.update_yaxes(type="category", showgrid=False)


def effects(bars: Sequence[tuple[str, float]], chance_level: float) -> go.Figure | None:
    """One bar for each quantity, the first on top.

    Args:
        bars: names and effects, from −1 to 1.
        chance_level: size of what may be chance.
    """
    if not bars:
        return None
    height_px = _FRAME_PX + _EFFECT_PX * len(bars)
    figure = style.new_figure(height_px, "effect")
    sizes = [effect for _, effect in bars]
    beyond = [abs(effect) > chance_level for effect in sizes]
    figure.add_bar(
        y=[style.plain(name) for name, _ in bars], x=sizes, orientation="h",
        marker={"color": [style.palette(0) if known else "#b8c4cc" for known in beyond]},
        text=[f"{effect:+.2f}" for effect in sizes], textposition="outside", cliponaxis=False,
        hovertemplate="%{y}: %{x:+.2f}<extra></extra>",
    )  # fmt: skip
    figure.add_vrect(
        x0=-chance_level, x1=chance_level, fillcolor=style.BAND, line_width=0, layer="below"
    )
    figure.update_xaxes(range=[-1.1, 1.1])
    return figure.update_yaxes(autorange="reversed", automargin=True)


def _add_curve(figure: go.Figure, study: DrawnStudy, line: Curve, quantity: StudyQuantity) -> None:
    def drawn(which: str) -> list[float | None]:
        values = (quantity.value(runs, which) for _, runs in line.points)
        return [None if v is None or (quantity.is_log and v <= 0.0) else v for v in values]

    colour = style.palette(line.colour)
    group = style.plain(line.key[0] if line.key else line.name)
    x = [value for value, _ in line.points]
    ends = zip(x, drawn("lowest"), drawn("highest"), strict=True)
    known = [end for end in ends if end[1] is not None]
    means, spread = drawn("mean"), dict[str, Any]()
    if quantity is PLANTS_KEPT or not line.is_sequence:  # intervals that overlap hide as bands
        above, below = map(_apart, drawn("highest"), means), map(_apart, means, drawn("lowest"))
        spread = {"symmetric": False, "array": list(above), "arrayminus": list(below)}
    elif any(lowest != highest for _, lowest, highest in known):
        figure.add_scatter(
            x=[end[0] for end in known] + [end[0] for end in reversed(known)],
            y=[end[2] for end in known] + [end[1] for end in reversed(known)],
            fill="toself", fillcolor=_pale(colour), line={"width": 0}, mode="lines",
            hoverinfo="skip", showlegend=False, legendgroup=group,
        )  # fmt: skip
    figure.add_scatter(
        x=x, y=means, name=style.plain(line.name), legendgroup=group, error_y=spread,
        customdata=[study.rerun_worst(runs) for _, runs in line.points],
        hovertemplate="%{x}: %{y:.3g}", **_looks(line, colour),
    )  # fmt: skip


def _apart(high: float | None, low: float | None) -> float | None:
    return None if high is None or low is None else high - low


def _looks(line: Curve, colour: str) -> dict[str, Any]:
    return {
        "mode": "lines+markers" if line.is_sequence else "markers",
        "line": {"color": colour, "width": 2, "dash": _DASHES[line.dash % len(_DASHES)]},
        "marker": {"size": 7, "symbol": "circle-open" if line.is_hollow else "circle"},
    }


def _name_in_legend(figure: go.Figure, lines: Sequence[Curve]) -> list[str]:
    """Give each line its entry; where all have keys, each colour and each pattern instead."""
    keys = [line.key for line in lines if line.key]
    if len(keys) < len(lines):
        return [line.name for line in lines]
    figure.update_traces(showlegend=False)
    colours = {line.key[0]: line for line in lines if line.key}
    patterns = {line.key[1]: line for line in lines if line.key}
    for name, line in colours.items():
        figure.add_scatter(
            x=[None], y=[None], name=style.plain(name), legendgroup=style.plain(name), mode="lines",
            line={"color": style.palette(line.colour), "width": 4},
        )  # fmt: skip
    for name, line in patterns.items():
        figure.add_scatter(x=[None], y=[None], name=style.plain(name), **_looks(line, style.MUTED))
    return [*colours, *patterns]


def _pale(colour: str) -> str:
    red, green, blue = (int(colour[start : start + 2], 16) for start in (1, 3, 5))
    return f"rgba({red},{green},{blue},0.14)"
