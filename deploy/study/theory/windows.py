"""Constant delays with which a sampled loop is unstable."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from bus_schema.arrays import Vector
from deploy.study.theory.crossings import Crossings, refined
from deploy.study.theory.sampled_loop import SampledLoop

_RESOLUTION_S = 1e-5
_SLOWEST = 1e-6
"""Smallest angle of a response, and growth per period that counts as stable."""
_SHARPEST = 64
_AROUND = np.geomspace(0.05, 50.0, 24)
_AROUND = np.array([*-_AROUND[::-1], 0.0, *_AROUND])


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


def unstable_windows(
    loop: SampledLoop, roots: Any, angles: Vector, longest_s: float
) -> list[Window]:
    """Return the windows of instability up to the longest delay.

    Args:
        loop: the loop.
        roots: its roots without a delay.
        angles: `telling_angles`.
        longest_s: the longest delay.
    """
    periods = longest_s / loop.period_s
    delays, leaving, where = Crossings(loop, angles, int(np.ceil(periods))).all()
    outside = np.count_nonzero(abs(roots) > 1.0 + _SLOWEST) + np.cumsum([0, *leaving])
    if (outside < 0).any():
        raise ArithmeticError("its roots cannot be counted")
    is_edge = np.diff(outside > 0)
    edges = [refined(loop, *each) for each in zip(delays[is_edge], where[is_edge], strict=True)]
    edges = ([(0.0, 0.0)] if outside[0] else []) + edges + [(periods, 0.0)]
    found = list[Window]()
    for (begin, angle), (end, _) in zip(edges[::2], edges[1::2], strict=False):
        begin_s, end_s = loop.period_s * begin, min(loop.period_s * end, longest_s)
        if found and begin_s - found[-1].end_s < _RESOLUTION_S:
            found[-1] = found[-1]._replace(end_s=end_s)
        elif end_s - begin_s > _RESOLUTION_S:
            found.append(Window(begin_s, end_s, angle))
    return found


def telling_angles(loop: SampledLoop, roots: Any) -> Vector:
    """Return angles from 0 to π that are close where responses change fast: at poles and roots."""
    poles = [*np.linalg.eigvals(loop.transition), *np.roots([1.0, *loop.law.recursion]), *roots]
    upper = (z for z in poles if z.imag >= 0.0)
    sharp = sorted(upper, key=lambda z: abs(1.0 - abs(z)))[:_SHARPEST]
    near = [np.angle(z) + (abs(1.0 - abs(z)) + 1e-9) * _AROUND for z in sharp]
    even = np.linspace(0.0, np.pi, 64 + 8 * len(loop.law.taps))
    found = np.concatenate([np.geomspace(_SLOWEST, np.pi, 400), even, *near])
    return np.unique(found[(found >= _SLOWEST) & (found <= np.pi)])
