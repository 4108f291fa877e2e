"""Noise of torques that is correlated in time: how much there is, and what it does to sums.

What a joint's model leaves is taken for white noise and noise with autocorrelation exp(−|t|/τ), in
unknown shares. Their likelihood counts what the parameters have absorbed of the noise (restricted
likelihood: Patterson and Thompson, "Recovery of inter-block information when block sizes are
unequal", 1971), as a slow noise looks like an offset. Variances are means over all τ and shares,
weighted by their likelihoods: a short log that cannot tell a small noise from a large slow one has
wide intervals. Noise of two joints, or of two motions, is independent.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from bus_schema.arrays import Matrix, Vector
from bus_schema.runtime.compiled import compiled

_TIMES, _SHORTEST_S = 7, 0.1
_SHARES = np.array([0.0, *np.geomspace(0.02, 2000.0, 11)])
"""Variance of the correlated noise over that of the white noise."""
_UNSURE = 1.4
"""Factor on the variance of correlated noise, which a log shows a few times its correlation."""
_ROUNDS = 10
"""In which a variance and what the parameters absorb of it agree."""
_MOST_ROWS = 1000
"""From which the noise of a joint is estimated."""
_BANDWIDTH = 1.06
"""Noise-equivalent bandwidth of the filter of the samples over its cutoff."""


@dataclass(frozen=True)
class _Noise:
    """Noise of a joint, in units of its weighted residuals.

    Attributes:
        white: variance of the white noise.
        times_s: correlation times of the rest.
        correlated: variance for each of them.
    """

    white: float
    times_s: Vector
    correlated: Vector

    def of_sums(self, design: Matrix, times_s: Vector, runs: NDArray[np.int64]) -> Matrix:
        """Return the covariance of Σ design · noise, shape (columns, columns).

        Args:
            design: shape (rows, columns).
            times_s: of the rows, shape (rows,).
            runs: number of the motion of each row; noise of two motions is independent.
        """
        total = self.white * design.T @ design
        for correlation_s, variance in zip(self.times_s, self.correlated, strict=True):
            decays = _decays(times_s, runs, correlation_s)
            smooth = design.copy()
            _accumulate(smooth, decays)
            product = design.T @ smooth  # of each row with itself and those before
            total += variance * (product + product.T - design.T @ design)
        return total


def widening_of(times_s: Vector, cutoff_hz: float) -> float:
    """Return how much more sums of filtered white noise deviate than if all samples were apart."""
    rate_hz = 1.0 / float(np.median(np.diff(times_s)))
    return float(np.sqrt(max(1.0, rate_hz / (2.0 * _BANDWIDTH * cutoff_hz))))


def covariance_of_sums(
    design: NDArray[np.float64], left: Matrix, times_s: Vector, runs: NDArray[np.int64],
    cutoff_hz: float,
) -> Matrix:  # fmt: skip
    """Return the covariance of Σ design · noise over rows and joints, shape (columns, columns).

    Args:
        design: derivatives of residuals, shape (rows, joints, columns).
        left: residuals in units of about their own deviation, shape (rows, joints).
        times_s: of the rows, each motion for itself.
        runs: number of the motion of each row.
        cutoff_hz: of the filter of the rows.
    """
    found = np.zeros((design.shape[2],) * 2)
    widening = widening_of(times_s, cutoff_hz)
    apart = slice(None, None, max(round(widening**2), -(-len(left) // _MOST_ROWS)))
    for joint in range(left.shape[1]):
        used = np.flatnonzero(design[:, joint].any(axis=0))
        own = design[:, joint, used]
        noise = _noise_of(left[apart, joint], own[apart], times_s[apart], runs[apart])
        wider = replace(
            noise, white=noise.white * widening**2, correlated=noise.correlated * _UNSURE
        )
        found[np.ix_(used, used)] += wider.of_sums(own, times_s, runs)
    return found


def _noise_of(left: Vector, design: Matrix, times_s: Vector, runs: NDArray[np.int64]) -> _Noise:
    """Return the noise of a joint.

    Args:
        left: weighted residuals, shape (rows,), few enough that white noise is white in them.
        design: their derivatives by parameters with a prior of variance 1, shape (rows, columns).
        times_s: of the rows.
        runs: number of the motion of each row.
    """
    longest_s = max(float(np.ptp(times_s[runs == run])) for run in np.unique(runs))
    correlations_s = np.geomspace(_SHORTEST_S, max(longest_s, 2.0 * _SHORTEST_S), _TIMES)
    rows = np.column_stack([design, left])
    logs = np.empty((_TIMES, _SHARES.size))
    white = np.empty_like(logs)
    for place, correlation_s in enumerate(correlations_s):
        decays = _decays(times_s, runs, correlation_s)
        for at, share in enumerate(_SHARES):
            logs[place, at], white[place, at] = _likelihood(rows, decays, float(share))
    weights = np.exp(logs - logs.max())
    weights[:, _SHARES == 0.0] *= np.count_nonzero(_SHARES)  # as likely as all others before
    weights *= white / weights.sum()
    return _Noise(float(weights.sum()), correlations_s, weights @ _SHARES)


def _likelihood(rows: Matrix, decays: Vector, share: float) -> tuple[float, float]:
    """Return the logarithm of the restricted likelihood, and the variance of the white noise."""
    whitened = rows.copy()
    determinant = _whiten(whitened, decays, share)
    variance, logarithm = _of_white(whitened.T @ whitened, len(rows))
    return -0.5 * (determinant + logarithm), variance


def _decays(times_s: Vector, runs: NDArray[np.int64], correlation_s: float) -> Vector:
    """Return the correlation of each row with the one before; 0 where a motion begins."""
    found, goes_on = np.zeros(len(times_s)), np.diff(runs) == 0
    found[1:][goes_on] = np.exp(-np.diff(times_s)[goes_on] / correlation_s)  # else time jumps back
    return found


@compiled
def _whiten(rows: Matrix, decays: Vector, share: float) -> float:
    """Turn white and correlated noise in columns into white noise of variance 1 (Kalman filter).

    Returns the logarithm of the determinant of the noise's covariance.
    """
    count, columns = rows.shape
    predicted = np.zeros(columns)
    variance, logarithm = share, 0.0
    for row in range(count):
        decay = decays[row]
        variance = decay * decay * variance + (1.0 - decay * decay) * share
        total = variance + 1.0
        gain, scale = variance / total, 1.0 / np.sqrt(total)
        for column in range(columns):
            guess = decay * predicted[column]
            innovation = rows[row, column] - guess
            predicted[column] = guess + gain * innovation
            rows[row, column] = innovation * scale
        logarithm += np.log(total)
        variance = gain
    return logarithm


@compiled
def _of_white(square: Matrix, count: int) -> tuple[float, float]:
    """Return the likeliest variance of white noise, and its part of −2 log likelihood.

    Compiled, as threads of BLAS that wait for each other take longer than these small matrices.

    Args:
        square: products of all columns, of which the last has the residuals.
        count: of rows.
    """
    size = square.shape[0] - 1
    lower, inverse = np.zeros_like(square), np.zeros(size)
    variance, logarithm = square[size, size] / count, 0.0
    for _ in range(_ROUNDS):
        for row in range(size + 1):  # Cholesky; the last row becomes L⁻¹ of the products
            for column in range(min(row + 1, size)):
                value = square[row, column] - (lower[row, :column] * lower[column, :column]).sum()
                if row == column:
                    lower[row, row] = np.sqrt(value + variance)
                else:
                    lower[row, column] = value / lower[column, column]
        trace, determinant = 0.0, 0.0
        for column in range(size):
            determinant += 2.0 * np.log(lower[column, column])
            for row in range(column, size):
                value = 1.0 if row == column else 0.0
                value -= (lower[row, column:row] * inverse[column:row]).sum()
                inverse[row] = value / lower[row, row]
                trace += inverse[row] ** 2
        rest = square[size, size] - (lower[size, :size] ** 2).sum()
        absorbed = determinant - size * np.log(variance)
        logarithm = count * np.log(variance) + absorbed + rest / variance
        variance = rest / (count - size + variance * trace)
    return variance, logarithm


@compiled
def _accumulate(rows: Matrix, decays: Vector) -> None:
    """Add to each row those before it, each less by the correlation of the noise there."""
    for row in range(1, rows.shape[0]):
        for column in range(rows.shape[1]):
            rows[row, column] += decays[row] * rows[row - 1, column]
