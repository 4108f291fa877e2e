"""Exponential divergence of an error as it leaves its bounds, swinging or not.

Near an unstable equilibrium an error e follows ë = α e + β ė + γ, whatever else moves the arm
slowly. Of evenly sampled values, that is an exact relation between three neighbours, whose poles
are the loop's dominating ones. It is fitted to parts of the time around the loss, and counts where
it explains the second differences of a part and of both its halves, with the same growing pole.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from bus_schema.arrays import Vector
from deploy.judge.findings.growing import Growth

_ENDS_S = (0.0, 0.1, 0.2, 0.3)
"""Ends of the parts after the loss: later, torques saturate."""
_SHORTEST_S, _LONGER, _LENGTHS = 0.04, 2.0**0.5, 24
_FEWEST = 30
_EXPLAINED = 0.98
"""Share of the second differences' variance."""
_SAME, _SAME_SWINGING = 0.6, 0.3
"""Largest difference between the rates of a part and its halves, as a share: it is 0.48 for the
linear growth of a resonance by a factor of e."""
_LEAST_GROWTH = 0.7
"""Over a part, in e-folds; a swinging error also turns once."""


@dataclass(frozen=True)
class _Pole:
    explained: float
    rate: float
    """Per sample."""
    radians: float
    """Per sample."""


def divergence(errors_rad: Vector, torques_nm: Vector, lost: int, rate_hz: float) -> Growth | None:
    """Return the growth by which a joint's error left its bounds; None if it was not exponential.

    Args:
        errors_rad: of the joint, from the first tick to look at, evenly spaced, shape (ticks,).
        torques_nm: of its actuator. An error that does not swing must be driven by it.
        lost: the first tick outside the bounds.
        rate_hz: ticks per second.
    """
    found = [
        (pole.explained, pole)
        for part in _parts(len(errors_rad), lost, rate_hz)
        if (pole := _common_pole(errors_rad[part], torques_nm[part])) is not None
    ]
    if not found:
        return None
    _, best = max(found, key=lambda each: each[0])
    return Growth(best.rate * rate_hz, best.radians * rate_hz / (2.0 * np.pi))


def _parts(ticks: int, lost: int, rate_hz: float) -> Iterator[slice]:
    for end_s in _ENDS_S:
        end = min(ticks, lost + 1 + round(end_s * rate_hz))
        for power in range(_LENGTHS):
            begin = max(0, end - round(_SHORTEST_S * _LONGER**power * rate_hz))
            if end - begin >= _FEWEST:
                yield slice(begin, end)
            if begin == 0:
                break


def _common_pole(errors: Vector, torques: Vector) -> _Pole | None:
    """Return the growing pole of a part, if both its halves have it too."""
    middle = len(errors) // 2
    poles = [_pole(each) for each in (errors, errors[:middle], errors[middle:])]
    whole, rates = poles[0], [each.rate for each in poles]
    if min(each.explained for each in poles) < _EXPLAINED or min(rates) <= 0.0:
        return None
    e_folds, turned = whole.rate * len(errors), whole.radians * len(errors)
    swings = whole.radians > 0.0
    is_same = np.ptp(rates) <= (_SAME_SWINGING if swings else _SAME) * whole.rate and (
        np.ptp([each.radians for each in poles]) <= _SAME * abs(complex(whole.rate, whole.radians))
    )
    if swings:
        grows = turned >= np.pi and e_folds >= _LEAST_GROWTH
    else:
        is_driven = float(((torques - torques.mean()) * errors).sum()) > 0.0
        grows = is_driven and e_folds >= _LEAST_GROWTH
    return whole if is_same and grows else None


def _pole(errors: Vector) -> _Pole:
    """Return the fastest growing pole of the relation that fits three neighbours best."""
    second = errors[2:] - 2.0 * errors[1:-1] + errors[:-2]
    known = np.stack([errors[:-2], errors[1:-1] - errors[:-2], np.ones(len(second))], axis=1)
    varying = second - second.mean()
    total = float((varying**2).sum())
    scale = np.abs(known).max(axis=0)
    if not (total > 0.0 and (scale > 0.0).all() and np.isfinite(total)):
        return _Pole(0.0, 0.0, 0.0)
    factors, *_ = np.linalg.lstsq(known / scale, second, rcond=None)
    explained = 1.0 - float(((second - (known / scale) @ factors) ** 2).sum()) / total
    alpha, beta, _ = (factors / scale).tolist()
    # (z - 1)² = α + β (z - 1)
    roots = [1.0 + 0.5 * (beta + sign * complex(beta**2 + 4.0 * alpha) ** 0.5) for sign in (1, -1)]
    root = max(roots, key=abs)
    if abs(root) == 0.0:
        return _Pole(0.0, 0.0, 0.0)
    pole = np.log(complex(root))
    return _Pole(explained, float(pole.real), abs(float(pole.imag)))
