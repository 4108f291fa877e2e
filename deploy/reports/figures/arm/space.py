"""A scene in space that stands still and is seen whole, whatever moves in it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from bus_schema.arrays import Matrix, Vector

_ROOM = 0.05
"""On every side, as a share of the longest one."""
_FROM = np.array([1.5, 1.3, 0.7])
_TAN_HALF_VIEW = 0.92 * np.tan(np.pi / 8)  # plotly looks through 45°; some is for ticks and titles
_LOWERED = 0.1
"""How far below the middle of the box the camera looks: most ticks and titles are at its foot."""


def still_space(points: NDArray[np.float64]) -> dict[str, object]:
    """Axes and camera of a scene of one scale along all axes, which holds all points.

    Left to itself, the scale would follow what is shown at the instant.

    Args:
        points: all that the scene has to hold, shape (..., 3), m; NaN where there is none.
    """
    flat = points.reshape(-1, 3)
    lower, upper = np.nanmin(flat, axis=0), np.nanmax(flat, axis=0)
    room = _ROOM * max(float((upper - lower).max()), 1e-3)
    lower, upper = lower - room, upper + room
    spans = upper - lower
    aspects = spans / np.sqrt(np.mean(spans**2))  # as large as a cube, whatever its form
    axes = {
        f"{name}axis": {"title": {"text": f"{name} (m)"}, "nticks": 6, "range": [low, high]}
        for name, low, high in zip("xyz", lower.tolist(), upper.tolist(), strict=True)
    }
    return {
        "aspectmode": "manual",
        "aspectratio": dict(zip("xyz", aspects.tolist(), strict=True)),
        "camera": whole_view(aspects),
        **axes,
    }


def whole_view(sides: Vector) -> dict[str, object]:
    """The camera that sees a whole box around the origin in a picture as wide as it is high.

    Args:
        sides: of the box, shape (3,), in plotly's unit.
    """
    back = _FROM / np.linalg.norm(_FROM)
    right = np.cross([0.0, 0.0, 1.0], back)
    right /= np.linalg.norm(right)
    down = np.array([0.0, 0.0, -_LOWERED])
    corners = _corners(sides) - down
    aside = np.abs(corners @ np.column_stack([right, np.cross(back, right)])).max(axis=1)
    distance = float((aside / _TAN_HALF_VIEW + corners @ back).max())
    return {
        "eye": dict(zip("xyz", (distance * back + down).tolist(), strict=True)),
        "center": dict(zip("xyz", down.tolist(), strict=True)),
    }


def _corners(sides: Vector) -> Matrix:
    signs = np.stack(np.meshgrid(*[[-0.5, 0.5]] * 3), axis=-1).reshape(-1, 3)
    return np.asarray(signs * sides)
