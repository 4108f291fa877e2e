"""Delays at which roots of a sampled loop cross the unit circle.

At z = exp(jθ) and d = (n + f) h, a root lies on the circle if an eigenvalue of R_f(z) is z^n: its
modulus is 1, and its phase φ is n θ but for whole turns. For one f, the angles at which a modulus
is 1 do not depend on n, and in between, by Nyquist's criterion, the number of roots outside is

    N = N_0 − Σ σ ⌊(φ − n θ) / 2π⌋

over these angles, σ = 1 where the modulus falls and −1 where it rises. They are known at some f;
between two of these, angle and phase are interpolated. Where angles appear or disappear in pairs,
or change too much, another f is put in between. For loops without sampling it is the method of
Walton and Marshall, "Direct method for TDS stability analysis", IEE Proc. D 134 (1987).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import Any, TypeAlias

import numpy as np

from bus_schema.arrays import Vector
from deploy.study.theory.sampled_loop import SampledLoop

_TURN = 2.0 * np.pi
_FIRST_FRACTIONS, _TRIED_FRACTIONS = 4, 64
_NARROWEST = 1e-3
"""Distance of fractions f that is not halved any more."""
_ALIKE = 0.05
"""Largest distance, rad, of phase and angle of a crossing from what is expected at the next f."""
_ROUNDS = 8
_NEWTON_STEPS, _SMALL = 6, 1e-7
_NEAR = 0.25
"""Of a period: further away it is another crossing."""


_Found: TypeAlias = tuple[Any, Any, Any]
"""Delays in periods, how many roots leave the circle there, and the angles where they do."""


@dataclass(frozen=True)
class Line:
    """Angles between −π and π at which a modulus is 1, at one fraction of a period.

    Attributes:
        fraction: f.
        angles: θ, shape (crossings,).
        phases: φ, same shape.
        signs: σ, same shape.
        angle_rates: dθ/df, same shape.
        phase_rates: dφ/df, same shape.
    """

    fraction: float
    angles: Vector
    phases: Vector
    signs: Vector
    angle_rates: Vector
    phase_rates: Vector


class Crossings:
    """The crossings of a loop up to a number of periods.

    Args:
        loop: the loop.
        periods: number of periods.
    """

    def __init__(self, loop: SampledLoop, periods: int) -> None:
        self._loop, self._angles = loop, loop.angles
        self._whole = np.arange(periods)

    @cached_property
    def _answers(self) -> Any:
        return self._loop.answers(np.exp(1j * self._angles))

    def all(self) -> _Found:
        """Return delays in periods, in order, with the roots that leave there and their angles."""
        lines = [self._line(fraction) for fraction in self._fractions()]
        found = [each for two in pairwise(lines) for each in self._between(*two)]
        delays, leaving, angles = (np.concatenate(column) for column in zip(*found, strict=True))
        order = np.argsort(delays, kind="stable")
        return delays[order], leaving[order], angles[order]

    def _fractions(self) -> list[float]:
        """Return the first fractions: one between any two at which a modulus at a peak is 1."""
        tried = np.linspace(0.0, 1.0, _TRIED_FRACTIONS + 1)
        peaks = self._loop.peaks
        answers = self._loop.answers(np.exp(1j * peaks))
        beyond = np.array([(self._sizes(peaks, answers, f)[0] > 0.0).sum(axis=1) for f in tried])
        changes = tried[np.flatnonzero(np.diff(beyond, axis=0).any(axis=1))]
        between = 0.5 * (changes[1:] + changes[:-1])
        return sorted({*tried[:: _TRIED_FRACTIONS // _FIRST_FRACTIONS].tolist(), *between.tolist()})

    def _between(self, a: Line, b: Line) -> Iterator[_Found]:
        pairs = _alike(a, b)
        width = b.fraction - a.fraction
        if len(pairs[0]) == max(len(a.angles), len(b.angles)):
            yield self._passed(a, b, *pairs)
        elif width > _NARROWEST:
            middle = self._line(0.5 * (a.fraction + b.fraction))
            yield from self._between(a, middle)
            yield from self._between(middle, b)
        else:
            yield self._passed(a, b, *pairs)
            for line, (known, sign) in ((a, (pairs[0], 1.0)), (b, (pairs[1], -1.0))):
                yield self._alone(line, known, sign, a.fraction + 0.5 * width)

    def _passed(self, a: Line, b: Line, first: Any, second: Any) -> _Found:
        """Return the crossings between two lines, on cubic curves that connect them."""
        width, whole = b.fraction - a.fraction, self._whole[:, None]
        angles = a.angles[first], b.angles[second]
        angle_rates = width * a.angle_rates[first], width * b.angle_rates[second]
        phase_rates = width * a.phase_rates[first], width * b.phase_rates[second]
        wanted = a.phases[first] + 0.5 * (phase_rates[0] + phase_rates[1])
        turned = _TURN * np.round((wanted - b.phases[second]) / _TURN)
        phases = a.phases[first], b.phases[second] + turned
        x, y = ((phases[i] - whole * angles[i]) / _TURN for i in range(2))
        slopes = [(phase_rates[i] - whole * angle_rates[i]) / _TURN for i in range(2)]
        change = np.floor(y) - np.floor(x)
        at, curve = np.nonzero(change)
        count = abs(change[at, curve]).astype(int)
        at, curve = np.repeat(at, count), np.repeat(curve, count)
        each = np.concatenate([np.arange(one) for one in count] or [np.zeros(0)])
        x, y, *slopes = (values[at, curve] for values in (x, y, *slopes))
        # The whole numbers of turns that are passed, one after the other.
        turns = np.where(y > x, np.floor(x) + 1.0 + each, np.floor(x) - each)
        share = _share(turns - x, y - x, *slopes)
        between = angles[0][curve] + share * (angles[1] - angles[0])[curve]
        leaving = -a.signs[first][curve] * np.sign(y - x)
        return at + a.fraction + share * width, leaving, between

    def _alone(self, line: Line, known: Any, sign: float, fraction: float) -> _Found:
        """Return what pairs of curves change that end, or begin, near a line."""
        alone = np.setdiff1d(np.arange(len(line.angles)), known)
        falling, rising = (alone[line.signs[alone] == one] for one in (1.0, -1.0))
        around = np.exp(1j * line.angles)  # a pair may be on both sides of π
        pairs = _pairs(abs(around[falling][:, None] - around[rising]), np.inf)
        down, up = falling[pairs[0]], rising[pairs[1]]
        angles, phases = (
            each[down] + _TURN * np.round((each[up] - each[down]) / _TURN)
            for each in (line.angles, line.phases)
        )
        whole = self._whole[:, None]
        counted = np.floor((phases - whole * angles) / _TURN)
        counted -= np.floor((line.phases[up] - whole * line.angles[up]) / _TURN)
        at, curve = np.nonzero(counted)
        return at + fraction, sign * counted[at, curve], line.angles[down][curve]

    def _line(self, fraction: float) -> Line:
        angles = self._angles
        sizes = self._sizes(angles, self._answers, fraction)[0]
        which, rank = np.nonzero((sizes[1:] > 0.0) != (sizes[:-1] > 0.0))
        found, phases = self._level(which, rank, sizes, fraction)
        signs = np.where(sizes[which, rank] > 0.0, 1.0, -1.0)
        values = found, phases, signs, *self._rates(found, phases, fraction)
        return Line(fraction, *(np.concatenate([each, -each]) for each in values))

    def _rates(self, angles: Vector, phases: Vector, fraction: float) -> tuple[Vector, Vector]:
        """Return how fast angles and phases of crossings change with f."""
        step = -_SMALL if fraction > 0.5 else _SMALL
        here, beside, later = (
            self._nearest(angles + turn, fraction + change, np.exp(1j * phases))
            for turn, change in ((0.0, 0.0), (_SMALL, 0.0), (0.0, step))
        )
        over_angle, over_fraction = np.log(beside / here) / _SMALL, np.log(later / here) / step
        with np.errstate(divide="ignore", invalid="ignore"):
            rates = -over_fraction.real / over_angle.real
            return rates, (over_fraction + rates * over_angle).imag

    def _nearest(self, angles: Vector, fraction: float, wanted: Any) -> Any:
        """Return the eigenvalue at each angle that is nearest to a wanted one."""
        z = np.exp(1j * angles)
        values = _eigenvalues(self._loop.ratios(z, self._loop.answers(z), fraction))
        nearest = np.argmin(abs(values - wanted[:, None]), axis=1)
        return np.take_along_axis(values, nearest[:, None], 1)[:, 0]

    def _level(self, which: Any, rank: Any, sizes: Any, fraction: float) -> tuple[Vector, Vector]:
        """Return angles between two given ones where the modulus of a rank is 1, and the phases."""
        low, high = self._angles[which], self._angles[which + 1]
        at_low, at_high = sizes[which, rank], sizes[which + 1, rank]
        row, found, phases = np.arange(len(rank)), low, low
        for _ in range(_ROUNDS):  # the Illinois rule
            change = at_high - at_low
            found = high - at_high * (high - low) / np.where(change == 0.0, 1.0, change)
            answers = self._loop.answers(np.exp(1j * found))
            size, phase = self._sizes(found, answers, fraction)
            at, phases = size[row, rank], phase[row, rank]
            is_beyond = (at > 0.0) == (at_high > 0.0)
            at_low = np.where(is_beyond, 0.5 * at_low, at_high)
            low = np.where(is_beyond, low, high)
            high, at_high = found, at
        return found, phases

    def _sizes(self, angles: Vector, answers: Any, fraction: float) -> tuple[Any, Any]:
        """Return logarithms of all moduli, the largest first, and phases: (angles, joints)."""
        ratios = self._loop.ratios(np.exp(1j * angles), answers, fraction)
        values = _eigenvalues(ratios)
        order = np.argsort(-abs(values), axis=1)
        values = np.take_along_axis(values, order, 1)
        return np.log(abs(values) + 1e-300), np.angle(values)


def refined(loop: SampledLoop, delay: float, angle: float) -> tuple[float, float]:
    """Return delay, in periods, and angle of a crossing by Newton's method from near ones."""
    at = np.array([angle, delay])
    for _ in range(_NEWTON_STEPS):
        near = [_off(loop, *(at + change)) for change in (np.zeros(2), *_SMALL * np.eye(2))]
        slopes = (np.array(near[1:]) - near[0]).T / _SMALL
        at = at - np.linalg.lstsq([slopes.real, slopes.imag], [near[0].real, near[0].imag])[0]
    is_near = abs(at[1] - delay) < _NEAR and abs(_off(loop, *at)) < 1e-6
    return (float(at[1]), float(at[0])) if is_near else (delay, angle)


def _off(loop: SampledLoop, angle: float, delay: float) -> complex:
    """Return how far the nearest eigenvalue of z^(−n) R_f(z) is from 1."""
    z, (whole, fraction) = np.exp(1j * np.array([angle])), divmod(delay, 1.0)
    values = np.linalg.eigvals(loop.ratios(z, loop.answers(z), fraction)[0]) * z**-whole
    return complex(values[np.argmin(abs(values - 1.0))] - 1.0)


def _eigenvalues(matrices: Any) -> Any:
    return np.linalg.eigvals(matrices) if len(matrices) else matrices[:, 0]


def _share(passed: Vector, whole: Vector, first: Vector, last: Vector) -> Vector:
    """Return where a cubic from 0 to a whole, with these slopes at its ends, passes a value."""
    square, cube = 3.0 * whole - 2.0 * first - last, first + last - 2.0 * whole
    share = passed / whole
    for _ in range(_NEWTON_STEPS):
        slope = first + share * (2.0 * square + 3.0 * share * cube)
        off = share * (first + share * (square + share * cube)) - passed
        share = np.clip(share - off / np.where(slope == 0.0, 1.0, slope), 0.0, 1.0)
    return share


def _alike(a: Line, b: Line) -> tuple[Any, Any]:
    """Return numbers of crossings on two lines that belong to one curve, as two arrays."""
    half = 0.5 * (b.fraction - a.fraction)
    turned, moved = (
        (from_a + half * a_rate)[:, None] - (to_b - half * b_rate)
        for from_a, a_rate, to_b, b_rate in (
            (a.phases, a.phase_rates, b.phases, b.phase_rates),
            (a.angles, a.angle_rates, b.angles, b.angle_rates),
        )
    )
    distance = np.maximum(abs(np.exp(1j * turned) - 1.0), abs(moved))
    distance[~np.isfinite(distance) | (a.signs[:, None] != b.signs)] = np.inf
    return _pairs(distance, _ALIKE)


def _pairs(distance: Any, most: float) -> tuple[Any, Any]:
    """Return rows and columns of the nearest pairs, each in one pair at most."""
    left, rows, columns = distance.copy(), list[int](), list[int]()
    while left.size and left.min() < most:
        row, column = np.unravel_index(np.argmin(left), left.shape)
        rows.append(int(row))
        columns.append(int(column))
        left[row], left[:, column] = np.inf, np.inf
    return np.array(rows, int), np.array(columns, int)
