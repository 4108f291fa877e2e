"""Slow oscillations that grow: too few periods for a spectrum, but enough for a linear model.

The error of a linear loop under a smooth reference is a sum of exponentials c e^(λ t). The matrix
pencil finds them in a few periods, after Hua and Sarkar, "Matrix pencil method for estimating
parameters of exponentially damped/undamped sinusoids in noise", IEEE Trans. Acoust., Speech, Signal
Process. 38(5) (1990). A growing one counts if the model leaves next to nothing of the error, and
both ends of the time show it too.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from bus_schema.arrays import Vector

_SAMPLES = 96
_ORDERS = (2, 4, 6, 8, 10, 12)
_LEFT = 1e-3
"""Share of an error's RMS that a model may leave."""
_PART = 2.0 / 3.0
"""Both ends of the time are so long."""
LEAST_PERIODS = 2.0
_ABOVE_LEFT = 3.0
"""Least amplitude of an oscillation over the RMS of what the model leaves."""
_SAME_RATE, _SAME_POLE = 0.15, 0.2
"""Largest differences of a growing exponential between the whole time and its ends."""

Exponents = NDArray[np.complex128]


class Oscillation(NamedTuple):
    """A growing oscillation.

    Attributes:
        exponent: growth, 1/s, and angular frequency, rad/s, as its imaginary part.
        amplitude: at the end.
    """

    exponent: complex
    amplitude: float


_NONE = Oscillation(0j, 0.0)


class _Model(NamedTuple):
    exponents: Exponents
    amplitudes: Vector
    """At the end of the time."""
    left: float


def slow_oscillation(
    errors: Vector, rate_hz: float, least_growth: float, floor: float
) -> Oscillation | None:
    """Return the largest slow oscillation that grows; the exponent is 0 if there is none.

    Args:
        errors: evenly spaced in time, shape (samples,).
        rate_hz: samples per second.
        least_growth: least factor over the time by which it grows.
        floor: amplitude below which nothing counts.

    Returns:
        None if no linear model describes the errors, so that nothing is known.
    """
    size = float(np.abs(errors).max())  # squares of a diverging error may overflow
    if not np.isfinite(size):
        return None
    if size == 0.0 or (errors / size).std() <= floor / size:
        return _NONE
    mean, floor = _means(errors / size), floor / size
    step_s = (len(errors) // len(mean)) / rate_hz
    duration_s, ends = len(mean) * step_s, round(_PART * len(mean))
    models = list[_Model]()
    for part in (mean, mean[:ends], mean[-ends:]):
        if (model := _model(part, step_s)) is None:
            return None  # before the others, which take as long
        models.append(model)
    whole, first, last = models
    found = [
        Oscillation(exponent, amplitude)
        for exponent, amplitude in zip(
            whole.exponents.tolist(), whole.amplitudes.tolist(), strict=True
        )
        if exponent.imag * duration_s >= 2.0 * np.pi * LEAST_PERIODS
        and exponent.real * duration_s >= np.log(least_growth)
        and amplitude * np.exp(-exponent.real * duration_s) > max(_ABOVE_LEFT * whole.left, floor)
        and _has(first, exponent)
        and _has(last, exponent)
    ]
    largest = max(found, key=lambda each: each.amplitude, default=_NONE)
    return largest._replace(amplitude=size * largest.amplitude)


def _means(errors: Vector) -> Vector:
    """Return means of neighbours, which leave out what is fast."""
    each = max(1, len(errors) // _SAMPLES)
    number = len(errors) // each
    return np.asarray(errors[len(errors) - number * each :].reshape(number, each).mean(axis=1))


def _model(values: Vector, step_s: float) -> _Model | None:
    """Return the smallest sum of exponentials that describes the values; None for none."""
    most = _LEFT * float(values.std())
    rows = sliding_window_view(values, len(values) // 2 + 1)
    if len(rows) <= _ORDERS[-1]:
        return None
    _, _, bases = np.linalg.svd(rows, full_matrices=False)
    places = np.arange(len(values)) - (len(values) - 1)
    for order in _ORDERS:
        basis = bases[:order].T
        shift, *_ = np.linalg.lstsq(basis[:-1], basis[1:], rcond=None)
        poles = np.linalg.eigvals(shift).astype(np.complex128)
        exponents: Exponents = np.log(poles[np.abs(poles) > 0.0])
        powers = np.outer(places, exponents)
        largest = powers.real.max(axis=0)  # its exponential may overflow
        shapes = np.exp(powers - largest)
        factors, *_ = np.linalg.lstsq(shapes, values.astype(complex), rcond=None)
        left = float(np.sqrt(np.mean((values - (shapes @ factors).real) ** 2)))
        if left <= most:
            amplitudes = np.asarray(2.0 * np.abs(factors) * np.exp(-largest))
            return _Model(exponents / step_s, amplitudes, left)
    return None


def _has(model: _Model, exponent: complex) -> bool:
    """Whether a model has this exponent too."""
    same = np.abs(model.exponents - exponent) <= _SAME_POLE * abs(exponent)
    same &= np.abs(model.exponents.real - exponent.real) <= _SAME_RATE * exponent.real
    return bool(same.any())
