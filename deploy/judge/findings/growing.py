"""Errors that grow exponentially: a loop that is unstable, though still inside its bounds.

In the last part of a run, each joint's error is divided into overlapping Hann-windowed segments. A
loop that is unstable has a peak at the same frequency in all of them, whose logarithm rises along a
straight line. A resonance or the beat of two references rises along a curve, noise scatters about
it, and a limit cycle does not rise. Oscillations too slow for spectra are looked for by
`deploy.judge.findings.slow_growth`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from bus_schema.arrays import Matrix, Vector
from deploy.judge.findings.slow_growth import LEAST_PERIODS, Oscillation, slow_oscillation

_SEGMENTS = 7
_PART = 0.5
"""Share of a run, at its end, in which an error must grow all the time."""
_LEAST_SEGMENT = 32
_LEAST_PERIODS = 3
"""Of an oscillation in a segment; slower motions are the reference's and the law's own."""
_LEAST_OF_NEIGHBOUR = 0.8
"""A peak between two frequencies counts at both."""
_LEAST_OF_SURROUNDINGS = 3.0
"""A peak is so many times as high as the spectrum `_LEAST_PERIODS` places beside it."""
_LEAST_GROWTH = 1.6
_STRAIGHT = 0.995
"""Least share of the logarithm's variance that a straight line explains."""
_LEAST_EVEN = 0.82
"""Least ratio of the slopes of both halves; it is 0.79 for linear growth by `_LEAST_GROWTH`."""
_ROUNDINGS = 16.0
"""Of the position, below which nothing counts."""
_FEWEST_SWINGS, _MOST_SWINGS = 4, 8
_LEAST_SWING = 0.1
"""Share of the largest swing below which one is the reference's own, or noise."""


@dataclass(frozen=True)
class Growth:
    """The exponential growth of an oscillation: e^(rate t)."""

    rate_per_s: float
    frequency_hz: float


@dataclass(frozen=True)
class Growths:
    """Growth of a run's errors, and growth that the run is too short to show.

    Attributes:
        joints: growth of each joint's error; None for none.
        not_tested_below_hz: slower oscillations may grow unseen; None if nothing was tested.
    """

    joints: list[Growth | None]
    not_tested_below_hz: float | None


def longest_growth_time_s(duration_s: float) -> float:
    """Return the time for growth by a factor of e, s, above which a run's growth is not seen."""
    return float(_PART * duration_s * (_SEGMENTS - 1) / (_SEGMENTS + 1) / np.log(_LEAST_GROWTH))


def growths(errors_rad: Matrix, positions_rad: Matrix, rate_hz: float) -> Growths:
    """Return how each joint's error grows over the last half of a run.

    Args:
        errors_rad: errors at every tick, shape (ticks, joints).
        positions_rad: positions, whose rounding is part of the errors, same shape.
        rate_hz: ticks per second.
    """
    last = errors_rad[round((1.0 - _PART) * len(errors_rad)) :]
    hop = len(last) // (_SEGMENTS + 1)
    length = 2 * hop
    if length < _LEAST_SEGMENT or not np.isfinite(last).all():
        return Growths([None] * errors_rad.shape[1], None)
    window = np.hanning(length)
    segments = sliding_window_view(last, length, axis=0)[::hop][:_SEGMENTS]
    scale = 2.0 / window.sum()
    detrended = segments - segments.mean(axis=2, keepdims=True)
    amplitudes = scale * np.abs(np.fft.rfft(window * detrended))
    floors_rad = _ROUNDINGS * np.spacing(np.abs(positions_rad[-len(last) :]).max(axis=0))
    found = [
        _growth(amplitudes[:, joint], hop / rate_hz, floor_rad)
        for joint, floor_rad in enumerate(floors_rad.tolist())
    ]
    slow = [
        slow_oscillation(error, rate_hz, _LEAST_GROWTH, floor_rad)
        for error, floor_rad in zip(last.T, floors_rad.tolist(), strict=True)
    ]
    is_known = all(each is not None for each in slow)
    duration_s = len(last) / rate_hz
    below_hz = LEAST_PERIODS / duration_s if is_known else _LEAST_PERIODS * rate_hz / length
    return Growths(
        [
            fast or (_as_growth(other) if other else None)
            for fast, other in zip(found, slow, strict=True)
        ],
        below_hz,
    )


def _as_growth(oscillation: Oscillation) -> Growth | None:
    rate, rad_s = oscillation.exponent.real, oscillation.exponent.imag
    return Growth(rate, rad_s / (2.0 * np.pi)) if rate > 0.0 else None


def _growth(amplitudes_rad: Matrix, hop_s: float, floor_rad: float) -> Growth | None:
    """Return the growth of the largest peak, of amplitudes with shape (segments, frequencies)."""
    a, far = amplitudes_rad, _LEAST_PERIODS
    inner = a[:, far:-far]
    beside = np.maximum(a[:, far - 1 : -far - 1], a[:, far + 1 : 1 - far])
    around = np.maximum(a[:, : -2 * far], a[:, 2 * far :])
    is_peak = (inner >= _LEAST_OF_NEIGHBOUR * beside) & (inner >= _LEAST_OF_SURROUNDINGS * around)
    found = [
        (float(a[-1, place]), place, growth)
        for place in np.flatnonzero(is_peak.all(axis=0)) + far
        if a[:, place].min() > floor_rad and (growth := _exponent(a[:, place])) is not None
    ]
    if not found:
        return None
    _, place, per_hop = max(found)
    return Growth(per_hop / hop_s, float(place / (2.0 * hop_s)))


def _exponent(amplitudes_rad: Vector) -> float | None:
    """Return by how much the logarithm rises in a segment; None if not along a straight line."""
    logs, places = np.log(amplitudes_rad), np.arange(len(amplitudes_rad))
    rise, _ = np.polyfit(places, logs, 1)
    middle = len(logs) // 2
    first, second = logs[middle] - logs[0], logs[-1] - logs[middle]
    is_straight = np.corrcoef(places, logs)[0, 1] ** 2 >= _STRAIGHT
    is_even = min(first, second) >= _LEAST_EVEN * max(first, second)
    grows = logs[-1] - logs[0] >= np.log(_LEAST_GROWTH)
    return float(rise) if grows and is_straight and is_even else None


def turning_points(values: Vector) -> NDArray[np.intp]:
    """Return where values begin to rise or to fall."""
    steps = np.diff(values)
    return np.flatnonzero(steps[1:] * steps[:-1] < 0.0) + 1


def growing_swings(times_s: Vector, errors_rad: Vector) -> Growth | None:
    """Return the growth of an oscillation by its turning points; None for none that grows."""
    if not np.isfinite(errors_rad).all():
        return None
    turns = turning_points(errors_rad)
    swings = np.abs(np.diff(errors_rad[turns]))
    if not swings.size:
        return None
    grown = int(swings.argmax())  # it may saturate later
    is_large = np.flatnonzero(swings >= _LEAST_SWING * swings[grown])
    used = is_large[is_large <= grown][-_MOST_SWINGS:]
    if len(is_large) < _FEWEST_SWINGS or len(used) < 2:
        return None
    rate, _ = np.polyfit(times_s[turns[used + 1]], np.log(swings[used]), 1)
    half_periods_s = np.diff(times_s[turns])[is_large]
    hertz = float(0.5 / np.median(half_periods_s))
    return Growth(float(rate), hertz) if rate > 0.0 else None
