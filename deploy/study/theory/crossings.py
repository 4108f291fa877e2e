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
from typing import Any

import numpy as np

from bus_schema.arrays import Vector
from deploy.study.theory.sampled_loop import SampledLoop

_TURN = 2.0 * np.pi
_FIRST_FRACTIONS = 4
_NARROWEST = 1e-3
"""Distance of fractions f that is not halved any more."""
_ALIKE = 0.1
"""How far phase (rad) and angle of a crossing may be from a pure delay's, from one f to the next."""
_ROUNDS = 8


@dataclass(frozen=True)
class Line:
    """Angles in (0, 2π) at which a modulus is 1, at one fraction of a period.

    Attributes:
        fraction: f.
        angles: θ, shape (crossings,).
        phases: φ, same shape.
        signs: σ, same shape.
    """

    fraction: float
    angles: Vector
    phases: Vector
    signs: Vector


class Crossings:
    """The crossings of a loop up to a number of periods.

    Args:
        loop: the loop.
        angles: from 0 to π, so close that every modulus is monotonous between them near 1.
        periods: number of periods.
    """

    def __init__(self, loop: SampledLoop, angles: Vector, periods: int) -> None:
        self._loop, self._angles = loop, angles
        self._whole = np.arange(periods)

    @cached_property
    def _answers(self) -> Any:
        return self._loop.answers(np.exp(1j * self._angles))

    def all(self) -> tuple[Vector, Vector, Vector]:
        """Return delays in periods, in order, with the roots that leave there and their angles."""
        parts = np.linspace(0.0, 1.0, _FIRST_FRACTIONS + 1)
        lines = [self._line(fraction) for fraction in parts[:-1].tolist()]
        first = lines[0]
        lines.append(Line(1.0, first.angles, first.phases - first.angles, first.signs))
        found = [each for two in zip(lines, lines[1:], strict=False) for each in self._between(*two)]
        delays, leaving, angles = (np.concatenate(column) for column in zip(*found, strict=True))
        order = np.argsort(delays, kind="stable")
        return delays[order], leaving[order], angles[order]

    def _between(self, a: Line, b: Line) -> Iterator[tuple[Vector, Vector, Vector]]:
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

    def _passed(self, a: Line, b: Line, first: Any, second: Any) -> tuple[Vector, Vector, Vector]:
        """Return the crossings between two lines, on curves that connect them."""
        begin, end = a.angles[first], b.angles[second]
        from_phase = a.phases[first]
        turned = from_phase - begin * (b.fraction - a.fraction) - b.phases[second]
        to_phase = b.phases[second] + _TURN * np.round(turned / _TURN)
        before = (from_phase - self._whole[:, None] * begin) / _TURN
        after = (to_phase - self._whole[:, None] * end) / _TURN
        change = np.floor(after) - np.floor(before)
        whole, curve = np.nonzero(change)
        count = abs(change[whole, curve]).astype(int)
        whole, curve = np.repeat(whole, count), np.repeat(curve, count)
        each = np.concatenate([np.arange(one) for one in count] or [np.zeros(0)])
        x, y = before[whole, curve], after[whole, curve]
        rises = y > x
        # The whole numbers of turns that are passed, one after the other.
        turns = np.where(rises, np.floor(x) + 1.0 + each, np.floor(x) - each)
        share = (turns - x) / (y - x)
        delays = whole + a.fraction + share * (b.fraction - a.fraction)
        leaving = -a.signs[first][curve] * np.where(rises, 1.0, -1.0)
        return delays, leaving, begin[curve] + share * (end - begin)[curve]

    def _alone(
        self, line: Line, known: Any, sign: float, fraction: float
    ) -> tuple[Vector, Vector, Vector]:
        """Return what pairs of curves change that end, or begin, near a line."""
        alone = np.setdiff1d(np.arange(len(line.angles)), known)
        falling, rising = (alone[line.signs[alone] == one] for one in (1.0, -1.0))
        pairs = _pairs(abs(line.angles[falling][:, None] - line.angles[rising]), np.inf)
        down, up = falling[pairs[0]], rising[pairs[1]]
        turned = np.round((line.phases[up] - line.phases[down]) / _TURN)
        phases = line.phases[down] + _TURN * turned
        whole = self._whole[:, None]
        counted = np.floor((phases - whole * line.angles[down]) / _TURN)
        counted -= np.floor((line.phases[up] - whole * line.angles[up]) / _TURN)
        at, curve = np.nonzero(counted)
        return at + fraction, sign * counted[at, curve], line.angles[down][curve]

    def _line(self, fraction: float) -> Line:
        angles = self._angles
        sizes = self._sizes(angles, self._answers, fraction)[0]
        which, rank = np.nonzero((sizes[1:] > 0.0) != (sizes[:-1] > 0.0))
        found, phases = self._level(which, rank, sizes, fraction)
        signs = np.where(sizes[which, rank] > 0.0, 1.0, -1.0)
        return Line(
            fraction,
            np.concatenate([found, _TURN - found]),
            np.concatenate([phases, -phases]),
            np.concatenate([signs, -signs]),
        )

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
        values = np.linalg.eigvals(ratios) if len(ratios) else ratios[:, 0]
        order = np.argsort(-abs(values), axis=1)
        values = np.take_along_axis(values, order, 1)
        return np.log(abs(values) + 1e-300), np.angle(values)


def _alike(a: Line, b: Line) -> tuple[Any, Any]:
    """Return numbers of crossings on two lines that belong to one curve, as two arrays."""
    expected = a.phases - a.angles * (b.fraction - a.fraction)
    turned = abs(np.exp(1j * expected)[:, None] - np.exp(1j * b.phases))
    distance = np.maximum(turned, abs(a.angles[:, None] - b.angles))
    distance[a.signs[:, None] != b.signs] = np.inf
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
