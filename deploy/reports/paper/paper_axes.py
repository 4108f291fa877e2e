"""Labels and ticks of the axes of a figure in a paper."""

from __future__ import annotations

from itertools import pairwise
from typing import Any, Literal

from matplotlib import rcParams
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

_TURNED_DEG = 35.0
_FEW_DECADES, _PLAIN = 300.0, (1e-4, 1e5)
"""Span of a logarithmic axis up to which 2 and 5 have room, and where digits are short."""


def share_labels(drawn: Figure, axes: Any, has_own_scales: bool) -> None:
    """Put a label that all have beside or below the grid: at each subplot, they would meet."""
    if axes.shape[1] == 1:
        return
    shown = [at for at in axes.flat if at.get_visible()]
    size = rcParams["axes.labelsize"]
    below, beside = (
        {label for at in shown if (label := read(at))}
        for read in (Axes.get_xlabel, Axes.get_ylabel)
    )
    if len(below) == 1:
        drawn.supxlabel(*below, fontsize=size)
    if has_own_scales and len(beside) == 1:
        drawn.supylabel(*beside, fontsize=size)
    for column in axes.T:
        lowest = [at for at in column if at.get_visible()]
        if lowest:  # the place below the last one may be empty
            lowest[-1].tick_params(labelbottom=True)
    for at in shown:
        if len(below) == 1:
            at.set_xlabel("")
        _thin_out(at, "x")
        if has_own_scales:
            at.set_ylabel("" if len(beside) == 1 else at.get_ylabel())
            _thin_out(at, "y")


def turn_crowded_names(drawn: Figure, axes: Any) -> None:
    """Turn the names below subplots that would overprint each other."""
    drawn.draw_without_rendering()  # only then the places of the names are known
    for at in (each for each in axes.flat if each.get_visible()):
        boxes = [name.get_window_extent() for name in at.get_xticklabels() if name.get_text()]
        if any(left.x1 >= right.x0 for left, right in pairwise(boxes)):
            at.tick_params(axis="x", labelrotation=_TURNED_DEG)
            for name in at.get_xticklabels():
                name.set(ha="right", rotation_mode="anchor")


def _thin_out(at: Axes, axis: Literal["x", "y"]) -> None:
    """Leave at most three ticks; a logarithmic axis has few already."""
    if (at.get_xscale() if axis == "x" else at.get_yscale()) == "linear":
        at.locator_params(axis=axis, nbins=3)


def write_plain_powers(axes: Any) -> None:
    """Write 1, 2, 5, 10 on logarithmic axes of few decades, in place of powers of ten."""
    for at in (each for each in axes.flat if each.get_visible() and each.get_yscale() == "log"):
        low, high = at.get_ylim()
        if not _FEW_DECADES * low >= high or not _PLAIN[0] <= low <= high <= _PLAIN[1]:
            continue
        at.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
        at.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
        at.yaxis.set_minor_formatter(NullFormatter())
