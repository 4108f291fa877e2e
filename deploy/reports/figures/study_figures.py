"""Figures of studies: curves with their spread, bars, and heat maps; every point knows its rerun.

The command that runs a point again is its `customdata`, which the page shows on a click.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import plotly.graph_objects as go

from deploy.reports.figures import style
from deploy.reports.studies.study_result import Runs, Spread
from deploy.reports.tables import scaled

_DASHES = ("solid", "dash", "dashdot", "longdash")  # dots are for limits
HEIGHT_PX = 430


class DrawnStudy(NamedTuple):
    """A sweep or margins: the summary, and a function from a point's name to its command."""

    summary: dict[str, Any]
    rerun: Callable[[str], str]

    def rerun_worst(self, runs: Runs | None) -> str:
        """Return the command that repeats the worst of some runs; empty for none."""
        if runs is None:
            return ""
        return self.rerun(runs.worst_point or runs.worst_points[0])


@dataclass(frozen=True)
class StudyQuantity:
    """Quantity that is drawn of several runs.

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
        spread: Spread | None = getattr(runs, self.key, None)
        if self is RUNS_LOST:
            spread = Spread(mean=1.0 - runs.runs_kept / runs.runs)
        if self is PLANTS_KEPT:
            low, high = runs.interval or (None, None)
            spread = Spread(mean=runs.fraction, lowest=low, highest=high)
        return None if spread is None else scaled(getattr(spread, which), self.factor)


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
    figure = style.new_figure(HEIGHT_PX, x_title, quantity.axis)
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
