"""Noise of torques that is correlated in time: how much there is, and what it does to sums.

What a joint's model leaves is taken for white noise and noise with autocorrelation exp(−|t|/τ), in
unknown shares. Their likelihood counts what the parameters have absorbed of the noise (restricted
likelihood: Patterson and Thompson, "Recovery of inter-block information when block sizes are
unequal", 1971), as a slow noise looks like an offset. Variances are means over all τ and shares,
weighted by their likelihoods: a short log that cannot tell a small noise from a large slow one has
wide intervals.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bus_schema.arrays import Matrix, Vector
from bus_schema.runtime.compiled import compiled

_TIMES, _SHORTEST_S = 7, 0.1
_SHARES = np.array([0.0, *np.geomspace(0.02, 50.0, 8)])
"""Variance of the correlated noise over that of the white noise."""


@dataclass(frozen=True)
class Noise:
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


def noise_of(left: Vector, design: Matrix, times_s: Vector, runs: NDArray[np.int64]) -> Noise:
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
    weights[1:, _SHARES == 0.0] = 0.0  # the same for each correlation
    weights *= white / weights.sum()
    return Noise(float(weights.sum()), correlations_s, weights @ _SHARES)


def _likelihood(rows: Matrix, decays: Vector, share: float) -> tuple[float, float]:
    """Return the logarithm of the restricted likelihood, and the variance of the white noise."""
    whitened = rows.copy()
    determinant = _whiten(whitened, decays, share)
    square = whitened.T @ whitened
    normal, right, total = square[:-1, :-1], square[:-1, -1], square[-1, -1]
    with_prior = normal + np.eye(len(right))
    absorbed = float(np.trace(np.linalg.solve(with_prior, normal)))
    rest = float(total - right @ np.linalg.solve(with_prior, right))
    free = len(rows) - absorbed
    variance = rest / free
    log = -0.5 * (determinant + np.linalg.slogdet(with_prior)[1] + free * np.log(variance))
    return float(log), variance


def _decays(times_s: Vector, runs: NDArray[np.int64], correlation_s: float) -> Vector:
    """Return the correlation of each row with the one before; 0 where a motion begins."""
    found = np.exp(-np.diff(times_s, prepend=times_s[0]) / correlation_s)
    found[np.diff(runs, prepend=-1) != 0] = 0.0
    return np.asarray(found)


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
def _accumulate(rows: Matrix, decays: Vector) -> None:
    """Add to each row those before it, each less by the correlation of the noise there."""
    for row in range(1, rows.shape[0]):
        for column in range(rows.shape[1]):
            rows[row, column] += decays[row] * rows[row - 1, column]
