"""The legend of a figure in a paper."""

from __future__ import annotations

import math
from collections.abc import Collection
from typing import Any

from matplotlib.axes import Axes
from matplotlib.figure import Figure

INCH_MM, HIGHEST_MM = 25.4, 76.0
"""An inch, and the largest height of a figure."""
_LEGEND_ROW_MM = 4.0
_WIDER = 1.3
"""Than its plot is an empty place of a grid, which has no numbers beside it."""


def put_legend(drawn: Figure, axes: Any, titles: Collection[str], least: int = 2) -> None:
    """Put a legend with each name once over all rows, or in an empty place.

    Args:
        drawn: the figure.
        axes: its subplots.
        titles: names that stand over subplots already.
        least: fewer names have no legend.
    """
    entries: dict[str, Any] = {}
    for at in axes.flat:
        for handle, label in zip(*at.get_legend_handles_labels(), strict=True):
            if label not in titles:
                entries.setdefault(label, handle)
    if len(entries) < least or _fills_empty_place(drawn, axes.flat[-1], entries):
        return
    for columns in (3, 2, 1):
        legend = drawn.legend(
            entries.values(), entries.keys(), loc="outside upper left", ncols=columns,
            frameon=False, columnspacing=1.0, handlelength=1.6, labelspacing=0.2,
        )  # fmt: skip
        width = legend.get_window_extent().width
        if width <= drawn.bbox.width:
            break
        if columns > 1:
            legend.remove()
    rows = math.ceil(len(entries) / columns)
    if rows > 2:
        height_mm = drawn.get_figheight() * INCH_MM + (rows - 2) * _LEGEND_ROW_MM
        drawn.set_figheight(min(height_mm, HIGHEST_MM) / INCH_MM)


def _fills_empty_place(drawn: Figure, last: Axes, entries: dict[str, Any]) -> bool:
    """Whether a grid's last place is empty, and a legend fits there, which then has been put."""
    if last.get_visible():
        return False
    drawn.draw_without_rendering()  # only then the size of the place is known
    legend = drawn.legend(
        entries.values(), entries.keys(), loc="center right", bbox_to_anchor=(1.0, 0.5),
        bbox_transform=last.transAxes, frameon=False, handlelength=1.6, labelspacing=0.2,
        borderpad=0.0,
    )  # fmt: skip
    legend.set_in_layout(False)
    box, place = legend.get_window_extent(), last.get_window_extent()
    if box.width <= _WIDER * place.width and box.height <= place.height:
        return True
    legend.remove()
    return False
