"""A bound below which a sampled loop is stable however its delay varies.

As long as messages stay in order and none is lost; after Kao and Lincoln, "Simple stability
criteria for systems with time-varying delays", Automatica 40 (2004), theorem 3.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from bus_schema.arrays import Matrix, Vector
from deploy.study.theory.sampled_loop import SampledLoop, exponential

_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(8)
_NEAR_PEAK = 0.5
_ROUNDS, _POINTS = 8, 9


def pattern_bound_s(loop: SampledLoop) -> float:
    """Return the delay below which a loop that is stable without is so for every pattern, s."""
    squares, axes = np.linalg.eigh(loop.plant.inertia)
    scale = (axes / np.sqrt(squares)) @ axes.T  # to joints with unit inertia
    kick = _kick(loop, np.linalg.inv(scale))

    def gains(at: Vector) -> Any:
        z = np.exp(1j * at)
        answers = loop.answers(z)
        differences = np.eye(len(scale)) - loop.ratios(z, answers, 0.0)
        closed = scale @ np.linalg.solve(differences, answers @ kick)
        return np.linalg.norm(closed, 2, axis=(1, 2)) * abs(z - 1.0)

    squared = 1.0 / (loop.period_s * _peak(gains, loop.angles) ** 2)
    whole = np.floor(np.sqrt(squared))
    return float(loop.period_s * (whole + (squared - whole**2) / (2.0 * whole + 1.0)))


def _peak(gains: Any, angles: Vector) -> float:
    """Return the supremum of a function that is smooth between neighbouring angles."""
    values = gains(angles)
    inner = np.concatenate([[0.0], values, [0.0]])
    is_peak = (values >= inner[:-2]) & (values >= inner[2:])
    places = np.flatnonzero(is_peak & (values > _NEAR_PEAK * values.max()))
    low = angles[np.maximum(places - 1, 0)]
    high = angles[np.minimum(places + 1, len(angles) - 1)]
    best = values[places]
    for _ in range(_ROUNDS):
        tried = np.linspace(low, high, _POINTS)
        found = gains(tried.ravel()).reshape(tried.shape)
        at = np.argmax(found, axis=0)
        best = np.maximum(best, found.max(axis=0))
        column = np.arange(len(places))
        low = tried[np.maximum(at - 1, 0), column]
        high = tried[np.minimum(at + 1, _POINTS - 1), column]
    return float(best.max())


def _kick(loop: SampledLoop, unscaled: Matrix) -> Matrix:
    """Return K, so that torques of unit energy within a period move the states by K w, |w| ≤ 1."""
    dynamics, inputs, h = loop.plant.dynamics, loop.plant.inputs @ unscaled, loop.period_s
    halvings = max(0, int(np.ceil(np.log2(1.0 + np.linalg.norm(dynamics, 1) * h))))
    part_s = h / 2.0**halvings
    parts = [
        np.sqrt(0.5 * part_s * weight) * exponential(dynamics * (0.5 * part_s * (1.0 + node)))
        for node, weight in zip(_NODES, _WEIGHTS, strict=True)
    ]
    kick, moved = np.hstack([part @ inputs for part in parts]), exponential(dynamics * part_s)
    for _ in range(halvings):
        kick, moved = np.linalg.qr(np.hstack([kick, moved @ kick]).T).R.T, moved @ moved
    return kick
