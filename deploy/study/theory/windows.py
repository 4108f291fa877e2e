"""Constant delays with which a sampled loop is unstable."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from deploy.study.theory.crossings import Crossings, refined
from deploy.study.theory.sampled_loop import SLOWEST, SampledLoop

_RESOLUTION_S = 1e-5
_AT_ONCE = 0.01
"""Of a period: the order of crossings that are so near each other is not known."""


class Window(NamedTuple):
    """Delays from the first to the last with which a loop is unstable.

    Attributes:
        begin_s: its first delay.
        end_s: its last delay.
        angle: angle of z at the root that crosses the circle at its begin.
    """

    begin_s: float
    end_s: float
    angle: float


def unstable_windows(loop: SampledLoop, longest_s: float) -> list[Window]:
    """Return the windows of instability up to the longest delay.

    Raises:
        ArithmeticError: crossings and roots without a delay contradict each other.
    """
    periods = longest_s / loop.period_s
    delays, leaving, angles = Crossings(loop, int(np.ceil(periods))).all()
    outside = np.count_nonzero(abs(loop.roots[0]) > 1.0 + SLOWEST) + np.cumsum([0, *leaving])
    lasting = np.diff([*delays, np.inf]) > _AT_ONCE
    if (outside[1:][lasting] < 0).any():
        raise ArithmeticError("the unstable roots could not be counted")
    is_edge = np.diff(outside > 0)
    edges = [refined(loop, *each) for each in zip(delays[is_edge], angles[is_edge], strict=True)]
    edges = ([(0.0, 0.0)] if outside[0] else []) + edges + [(periods, 0.0)]
    found = list[Window]()
    for (begin, angle), (end, _) in zip(edges[::2], edges[1::2], strict=False):
        begin_s, end_s = loop.period_s * begin, min(loop.period_s * end, longest_s)
        if found and begin_s - found[-1].end_s < _RESOLUTION_S:
            found[-1] = found[-1]._replace(end_s=end_s)
        elif end_s - begin_s > _RESOLUTION_S:
            found.append(Window(begin_s, end_s, angle))
    return found


def after_dead_time(windows: Sequence[Window], dead_s: float) -> list[Window]:
    """Return the same windows for a delay that is added to a constant one."""
    return [
        each._replace(begin_s=max(0.0, each.begin_s - dead_s), end_s=each.end_s - dead_s)
        for each in windows
        if each.end_s > dead_s
    ]
