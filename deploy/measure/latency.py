"""Dead time and lag of a recorded system, from a command and a response.

The model is τ ẏ = k u(t − d) + b − y or, of second order, critically damped with the same lag τ at
a steady speed, (τ/2)² ÿ + τ ẏ = k u(t − d) + b − y. The filtered command is exact between rows,
and k and b follow by least squares; a grid finds the best d and τ, and ever smaller steps refine
them. Confidence intervals allow for residuals that resemble their neighbours (Newey and West,
"A simple, positive semi-definite, heteroskedasticity and autocorrelation consistent covariance
matrix", 1987), and for rows that are too far apart to tell dead times from one another: they have
all dead times with which the model fits as well as with the best (its profile likelihood).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from bus_schema.arrays import Matrix, Vector
from bus_schema.runtime.compiled import compiled

_FEWEST_ROWS = 50
_DEAD_TIMES, _LAGS = 40, 10
_SHORTEST_LAG_S, _NO_LAG_S, _FINEST_S = 1e-5, 1e-12, 1e-6
_LEAST_EXPLAINED = 0.5
_WIDEST_S, _WIDEST_SHARE, _WIDEST_PERIODS = 2e-3, 0.1, 0.6
_Z_95 = 1.96
_SURELY_WORSE = _Z_95**2
"""A model whose deviance exceeds that of the best one by this is rejected at 95 %."""
_SURE_DIRECTION, _LIKE_NEIGHBOURS, _EXACT = 3.0, 0.5, 1e-9
"""Standard errors of a dependence on direction; correlation from row to row; share left over."""
_ALTERNATING, _FAR, _LEAST_FAR, _SINGLE, _MOSTLY = -0.75, 6.0, 0.01, 0.5, 0.9
"""Correlation; standard deviations; share of responses; runs of them per response; of one value."""
_MEDIAN_OF_NORMAL, _REWEIGHTED = 0.6745, 30
"""Median of absolute values of a standard normal variable; rounds of a robust fit."""
_NOTHING, _SHORT = 1e-15, 0.1
_HALVINGS, _FINEST_RATIO = 8, 1e-4


@dataclass(frozen=True)
class Latency:
    """Effects of a system on its commands; each value with half of its 95 % interval.

    Attributes:
        dead_time_s: before anything happens.
        lag_s: time constant of what happens then.
        together_s: dead time and lag: the delay that a slow motion shows.
        gain: response per command, in the end.
        explained: share of the response's variance that the model explains.
        misfit: why the model does not fit, so that the intervals mean nothing; None if it fits.
        order: of the model, 1 or 2.
    """

    dead_time_s: tuple[float, float]
    lag_s: tuple[float, float]
    together_s: tuple[float, float]
    gain: tuple[float, float]
    explained: float
    misfit: str | None
    order: int = 1


class _Fit:
    """The model on some rows.

    Args:
        times_s: increasing, shape (rows,).
        command: shape (rows,).
        response: shape (rows,); NaN where there is none.
        longest_s: of a dead time; rows before it only lead in.
        is_held: whether a command stays until the next, or is on a line to it.
        order: of the model.
    """

    def __init__(
        self, times_s: Vector, command: Vector, response: Vector, longest_s: float, *,
        is_held: bool, order: int = 1,
    ) -> None:  # fmt: skip
        self._filter = _filter if order == 1 else _filter_twice
        self._times_s, self._command = times_s, command
        slopes = np.diff(command) / np.diff(times_s)
        self._slopes = np.append(slopes * (not is_held), 0.0)
        self._first = int(np.searchsorted(times_s, times_s[0] + 2.0 * longest_s))
        self._seen = np.isfinite(response[self._first :])
        self.response = response[self._first :][self._seen]

    def regressors(self, dead_time_s: float, lag_s: float) -> Matrix:
        """The filtered command and a constant where there is a response, shape (responses, 2)."""
        columns = np.ones((len(self._seen), 2))
        self._filter(
            self._times_s, self._command, self._slopes, self._first, dead_time_s,
            lag_s if lag_s > _SHORTEST_LAG_S else _NO_LAG_S, columns[:, 0],
        )  # fmt: skip
        return columns[self._seen]

    def solve(self, dead_time_s: float, lag_s: float) -> tuple[Vector, Vector]:
        """Gain and constant, and what they leave."""
        filtered = self.regressors(dead_time_s, lag_s)[:, 0]
        about = filtered - filtered.mean()
        power = float((about**2).sum())
        gain = float((about * self.response).sum()) / power if power > 0.0 else 0.0
        constant = float(self.response.mean()) - gain * float(filtered.mean())
        return np.array([gain, constant]), self.response - gain * filtered - constant

    def cost(self, dead_time_s: float, lag_s: float) -> float:
        return float((self.solve(dead_time_s, lag_s)[1] ** 2).sum())


@compiled
def _filter(
    times_s: Vector, command: Vector, slopes: Vector, first: int, dead_time_s: float,
    lag_s: float, filtered: Vector,
) -> None:  # fmt: skip
    """Response of a lag to a command, delayed, at the rows from `first` on."""
    at, state = 0, command[0]
    for row in range(first, times_s.size):
        when_s = times_s[row] - dead_time_s
        while at + 1 < times_s.size and times_s[at + 1] <= when_s:
            span_s = times_s[at + 1] - times_s[at]
            lead = slopes[at] * lag_s
            decay = math.exp(-span_s / lag_s)
            state = command[at] + slopes[at] * span_s - lead + (state - command[at] + lead) * decay
            at += 1
        span_s = when_s - times_s[at]
        lead = slopes[at] * lag_s
        filtered[row - first] = (
            command[at] + slopes[at] * span_s - lead
            + (state - command[at] + lead) * math.exp(-span_s / lag_s)
        )  # fmt: skip


@compiled
def _filter_twice(
    times_s: Vector, command: Vector, slopes: Vector, first: int, dead_time_s: float,
    lag_s: float, filtered: Vector,
) -> None:  # fmt: skip
    """Response of second order to a command, critically damped, as `_filter` gives it."""
    bandwidth = 2.0 / lag_s
    at, state, speed = 0, command[0], slopes[0]
    for row in range(first, times_s.size):
        when_s = times_s[row] - dead_time_s
        while at + 1 < times_s.size and times_s[at + 1] <= when_s:
            span_s = times_s[at + 1] - times_s[at]
            away = state - command[at] + slopes[at] * lag_s
            pull = speed - slopes[at] + bandwidth * away
            decay = math.exp(-bandwidth * span_s)
            state = command[at] + slopes[at] * (span_s - lag_s) + (away + pull * span_s) * decay
            speed = slopes[at] + (pull - bandwidth * (away + pull * span_s)) * decay
            at += 1
        span_s = when_s - times_s[at]
        away = state - command[at] + slopes[at] * lag_s
        pull = speed - slopes[at] + bandwidth * away
        decay = math.exp(-bandwidth * span_s)
        filtered[row - first] = (
            command[at] + slopes[at] * (span_s - lag_s) + (away + pull * span_s) * decay
        )


def find_latency(
    times_s: Vector, command: Vector, response: Vector, longest_s: float, *, is_held: bool,
    order: int = 1,
) -> Latency:  # fmt: skip
    """Dead time and lag of a system.

    Args:
        times_s: increasing, shape (rows,).
        command: the commanded values, shape (rows,).
        response: what it did, shape (rows,); NaN where there is only a command.
        longest_s: the longest dead time and lag that are looked for.
        is_held: whether a command stays until the next, or is on a line to it.
        order: of the model, 1 or 2.

    Raises:
        ValueError: the rows do not say; the message says why.
    """
    seen_s = times_s[np.isfinite(response)]
    period_s = float(np.median(np.diff(seen_s))) if len(seen_s) > 1 else math.inf
    if np.ptp(times_s) < 4.0 * longest_s or len(seen_s) < _FEWEST_ROWS:
        raise ValueError(
            f"{len(seen_s)} rows over {np.ptp(times_s):.3g} s: needs {_FEWEST_ROWS} rows and four"
            f" times the longest latency, {longest_s:g} s"
        )
    fit = _Fit(times_s, command, response, longest_s, is_held=is_held, order=order)
    if np.ptp(command) == 0.0 or np.ptp(fit.response) == 0.0:
        raise ValueError("command or response never changes: the motion does not excite the system")
    best = _best(fit, longest_s, period_s)
    dead_time_s, lag_s = best.dead_time_s, best.lag_s
    (gain, _), residuals = fit.solve(dead_time_s, lag_s)
    explained = 1.0 - float(residuals.var() / fit.response.var())
    if explained < _LEAST_EXPLAINED:
        raise ValueError(f"a dead time and a lag explain {100 * explained:.0f} % of the response")
    if max(dead_time_s, lag_s) > 0.98 * longest_s:
        raise ValueError(f"dead time or lag reach the end of the search range, {longest_s:g} s")
    covariance = _covariance(fit, dead_time_s, lag_s, residuals)
    half = _Z_95 * np.sqrt(np.diag(covariance)) + _FINEST_S
    if lag_s < _SHORT * period_s:  # nothing changes gradually from row to row: no slopes tell
        half[:2] = _FINEST_S
    of_sum = _Z_95 * math.sqrt(max(0.0, covariance[:2, :2].sum()))
    half_of_sum = max(_FINEST_S, of_sum if lag_s >= _SHORT * period_s else 0.0)
    dead_time, lag, together = _intervals(
        fit, best, (*half[:2].tolist(), half_of_sum), longest_s, period_s
    )
    widest_s = max(_WIDEST_S + _WIDEST_SHARE * (dead_time_s + lag_s), _WIDEST_PERIODS * period_s)
    if not max(dead_time[1], lag[1]) <= widest_s:
        raise ValueError(
            "the motion does not excite the system enough to separate dead time and lag; together"
            f" they are {1e3 * (dead_time_s + lag_s):.2f} ± {1e3 * of_sum:.2f} ms"
        )
    is_exact = 1.0 - explained < _EXACT
    filtered = gain * fit.regressors(dead_time_s, lag_s)[:, 0]
    misfit = None if is_exact else _misfit(filtered, residuals)
    return Latency(dead_time, lag, together, (float(gain), half[2]), explained, misfit, order)


def _misfit(fitted: Vector, residuals: Vector) -> str | None:
    """Say in which way residuals are no noise; None if they may be noise.

    Args:
        fitted: responses of the model; their slope has the direction of the motion.
        residuals: what the model leaves, shape (responses,).
    """
    slope = np.gradient(fitted)
    direction = np.sign(slope) * (np.abs(slope) > _SHORT * slope.std())
    scores = ((direction - direction.mean()) * residuals)[:, np.newaxis]
    errors = abs(float(scores.sum())) / math.sqrt(max(float(long_run(scores)[0, 0]), 1e-300))
    if errors > _SURE_DIRECTION:
        return (
            f"what is left depends on the direction of motion ({errors:.1f} standard errors), as"
            " with stiction, backlash or the wrong interpolation of commands"
        )
    alike = float((residuals[1:] * residuals[:-1]).sum() / (residuals**2).sum())
    if alike > _LIKE_NEIGHBOURS:
        return f"what is left is no noise: from row to row its correlation is {alike:.2f}"
    if alike < _ALTERNATING:
        return (
            "what is left changes its sign from row to row"
            f" (correlation {alike:.2f}): two publishers may take turns"
        )
    return _two_sources(fitted, residuals)


def _two_sources(fitted: Vector, residuals: Vector) -> str | None:
    """Say that single responses are far from all others, as from a second source; else None."""
    left = _least_absolute(fitted, fitted + residuals)
    usual = max(float(np.median(np.abs(left))) / _MEDIAN_OF_NORMAL, _EXACT * float(fitted.std()))
    is_far = np.abs(left) > _FAR * usual
    share, runs = float(is_far.mean()), np.count_nonzero(np.diff(is_far.astype(int), prepend=0) > 0)
    if share < _LEAST_FAR or runs < _SINGLE * np.count_nonzero(is_far):
        return None
    far = (fitted + residuals)[is_far]
    is_one_value = np.mean(np.abs(far - np.median(far)) <= usual) > _MOSTLY
    value = f", most of them at {round(np.median(far) / usual) * usual:.3g}" if is_one_value else ""
    return (
        f"{100 * share:.0f} % of the responses, singly, are far from all others{value}: two"
        " publishers may send them, or their times are wrong"
    )


def _least_absolute(column: Vector, values: Vector) -> Vector:
    """Return what a straight line through points leaves, if the sum of absolute values is least."""
    columns = np.column_stack([column, np.ones(len(column))])
    weights, left = np.ones(len(values)), values
    for _ in range(_REWEIGHTED):  # iteratively reweighted least squares
        scaled = columns * weights[:, np.newaxis]
        left = values - columns @ np.linalg.lstsq(scaled, values * weights, rcond=None)[0]
        weights = 1.0 / np.sqrt(
            np.maximum(np.abs(left), _EXACT * float(np.abs(left).max()) + 1e-300)
        )
    return left


def _intervals(
    fit: _Fit, best: _Place, halves_s: tuple[float, ...], longest_s: float, period_s: float
) -> list[tuple[float, float]]:
    """Return intervals of dead time, lag and both, with all values that fit as well as the best.

    Args:
        fit: the model.
        best: dead time and lag.
        halves_s: of the narrowest intervals.
        longest_s: of a dead time.
        period_s: of the rows.
    """
    responses = len(fit.response)
    most = best.cost * (1.0 + _SURELY_WORSE / responses)
    most += _NOTHING * responses * float(fit.response.var())
    places = [best, *(_end(fit, best, most, longest_s, sign * period_s) for sign in (-1, 1))]
    lags_s = [_lag_end(fit, place, most, ratio) for place in places for ratio in (0.5, 2.0)]
    ends_s = (
        [place.dead_time_s for place in places], lags_s,
        [place.dead_time_s + place.lag_s for place in places],
    )  # fmt: skip
    values_s = best.dead_time_s, best.lag_s, best.dead_time_s + best.lag_s
    return list(map(_interval, values_s, halves_s, ends_s))


def _interval(best_s: float, half_s: float, ends_s: list[float]) -> tuple[float, float]:
    """Middle and half of what holds both an interval around the best value, and the ends."""
    low_s, high_s = min(best_s - half_s, *ends_s), max(best_s + half_s, *ends_s)
    return (low_s + high_s) / 2.0, (high_s - low_s) / 2.0


class _Place(NamedTuple):
    """A dead time with its best lag, or any lag, and the squares that they leave."""

    cost: float
    dead_time_s: float
    lag_s: float


def _best(fit: _Fit, longest_s: float, period_s: float) -> _Place:
    """Dead time and lag with the least squares."""
    dead_times = np.linspace(0.0, longest_s, _DEAD_TIMES).tolist()
    lags = [0.0, *np.geomspace(min(period_s, 0.1 * longest_s) / 4, longest_s, _LAGS).tolist()]
    places = [_Place(fit.cost(d, lag), d, lag) for d in dead_times for lag in lags]
    # Without a lag, nothing changes from one dead time to the next: no way leads from there.
    starts = {min(places), min(place for place in places if place.lag_s > 0.0)}
    return min(_refined(fit, start, longest_s) for start in starts)


def _refined(fit: _Fit, best: _Place, longest_s: float) -> _Place:
    """Dead time and lag with the least squares around these."""
    step_s = longest_s / _DEAD_TIMES
    while step_s > _FINEST_S:
        around = (min(max(best.dead_time_s + i * step_s, 0.0), longest_s) for i in (-1, 1))
        found = min(_with_best_lag(fit, dead_time_s, best.lag_s) for dead_time_s in around)
        if found.cost < best.cost:
            best = found
        else:
            step_s /= 2.0
    return best


def _with_best_lag(fit: _Fit, dead_time_s: float, lag_s: float) -> _Place:
    """A dead time with the lag that is best for it, looked for from another one on."""
    lag_s = max(lag_s, _SHORTEST_LAG_S)
    best, ratio = _Place(fit.cost(dead_time_s, lag_s), dead_time_s, lag_s), 2.0
    while ratio > 1.0 + _FINEST_RATIO:
        near = (max(best.lag_s * each, _SHORTEST_LAG_S) for each in (1.0 / ratio, ratio))
        found = min(_Place(fit.cost(dead_time_s, lag), dead_time_s, lag) for lag in near)
        if found.cost < best.cost:
            best = found
        else:
            ratio = math.sqrt(ratio)
    return best


def _end(fit: _Fit, best: _Place, most: float, longest_s: float, step_s: float) -> _Place:
    """Return the end of the dead times that leave `most`, in steps of at most `step_s`.

    It is just outside: rows of commands without lag fit up to, and with, a whole number of periods.
    """
    end = best
    while abs(step_s) > _FINEST_S / 2:
        while 0.0 <= end.dead_time_s + step_s <= longest_s:
            further = _with_best_lag(fit, end.dead_time_s + step_s, end.lag_s)
            if further.cost > most:
                break
            end = further
        step_s /= 2.0
    return end._replace(dead_time_s=max(0.0, end.dead_time_s + math.copysign(_FINEST_S, step_s)))


def _covariance(fit: _Fit, dead_time_s: float, lag_s: float, residuals: Vector) -> Matrix:
    """Of dead time, lag, gain and constant, from the slopes of the model and its residuals."""
    (gain, _), step_s = fit.solve(dead_time_s, lag_s)[0], 1e-4
    lag_s = max(lag_s, step_s)
    ends = [
        fit.regressors(dead_time_s + i * step_s, lag_s + j * step_s)[:, 0]
        for i, j in ((1, 0), (-1, 0), (0, 1), (0, -1))
    ]
    slopes = [gain * (ends[at] - ends[at + 1]) / (2.0 * step_s) for at in (0, 2)]
    jacobian = np.column_stack([*slopes, fit.regressors(dead_time_s, lag_s)])
    middle = long_run(jacobian * residuals[:, np.newaxis])
    inverse = np.linalg.pinv(jacobian.T @ jacobian, hermitian=True)
    return np.asarray(inverse @ middle @ inverse)


def long_run(scores: Matrix) -> Matrix:
    """Covariance of the sums of columns whose rows resemble their neighbours (Newey and West)."""
    middle = scores.T @ scores
    window = round(4.0 * len(scores) ** (1.0 / 3.0))
    for lag in range(1, window):
        product = scores[lag:].T @ scores[:-lag]
        middle += (1.0 - lag / window) * (product + product.T)
    return np.asarray(middle)


def _lag_end(fit: _Fit, place: _Place, most: float, ratio: float) -> float:
    """The lag farthest from that of a place that leaves `most` with its dead time."""
    lag_s = max(place.lag_s, _SHORTEST_LAG_S)
    for _ in range(_HALVINGS):
        while lag_s > _SHORTEST_LAG_S / 2 and fit.cost(place.dead_time_s, lag_s * ratio) <= most:
            lag_s *= ratio
        ratio = math.sqrt(ratio)
    return lag_s if lag_s > _SHORTEST_LAG_S else 0.0
