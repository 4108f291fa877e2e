"""Distributions of jitter, with correlation between successive messages.

Draws come from a Gaussian copula: a first-order autoregressive sequence of standard normal numbers
z, each put through the distribution's quantile function at Φ(z). So the distribution is kept
for any correlation, which is more than netem's mix of the last draw and a new one can say. The
sequence's own correlation is chosen such that the correlation of the *draws* is the one asked for.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from functools import cached_property
from pathlib import Path

import numpy as np

from bus_schema.arrays import Vector, elementwise
from bus_schema.foreign_files import refuse_foreign
from bus_schema.link.channel_configuration import ChannelConfiguration
from bus_schema.tables import MOST_BYTES, PARQUET, read_columns
from bus_schema.user_files import read_bytes

_BLOCK = 256
_HEADER_BYTES = 1000


def endless(draw: Callable[[int], Vector]) -> Iterator[float]:
    """Yields single numbers from a generator's method that draws many at once."""
    while True:
        yield from draw(_BLOCK).tolist()


Quantile = Callable[[float], float]
"""A distribution's quantile function at Φ(z)."""

_PARETO_SHAPE = 3.0
_PARETO_MEAN = 1.5
_PARETO_DEVIATION = math.sqrt(0.75)
_HERMITE_TERMS = 60
_Z = np.linspace(-12.0, 12.0, 4801)
_DENSITY = elementwise(math.exp, -0.5 * _Z**2)
_WEIGHTS = _DENSITY / _DENSITY.sum()


def read_delays_ms(path: Path) -> Vector:
    """Delays from a file with a column ``delay_ms``, or of one number a line; shape (delays,).

    In a file without names, empty lines and what follows a ``#`` do not count, and behind the
    number a line may have words.

    Returns:
        The delays, ascending.

    Raises:
        ValueError: there is no such file, or it holds something else, or more than that.
    """
    try:
        content = read_bytes(path, MOST_BYTES)
    except OSError as error:
        raise ValueError(f"{path} cannot be read: {error}") from error
    if content.startswith(PARQUET) or b"delay_ms" in content[:_HEADER_BYTES]:
        return np.sort(_named_delays_ms(path))
    refuse_foreign(path, content)
    try:
        lines = content.decode().splitlines()
    except UnicodeDecodeError as error:
        raise ValueError(f"{path} cannot be read: {error}") from error
    delays = [delay for number, line in enumerate(lines, 1) for delay in _delay(path, number, line)]
    if not delays:
        raise ValueError(f"{path} holds no delay")
    return np.sort(delays)


def _named_delays_ms(path: Path) -> Vector:
    """Return the column of delays, without lost messages."""
    columns = read_columns(path, ["delay_ms"], ["time_s", "lost", "size"])
    delays_ms = columns.values["delay_ms"]
    columns.refuse_where(
        ~((delays_ms >= 0.0) & (delays_ms < math.inf)), "delay_ms",
        "a delay is at least 0 and finite; for lost messages use link.uplink.trace",
    )  # fmt: skip
    if not columns.rows:
        raise ValueError(f"{path} holds no delay")
    return delays_ms


def _delay(path: Path, number: int, line: str) -> Iterator[float]:
    """Return the delay in a line of a file without column names; None for a comment."""
    cells = line.partition("#")[0].replace(",", " ").replace(";", " ").split()
    numbers = list(map(_number, cells))
    if not cells:
        return
    if numbers[0] is None:
        allowed = "a file with column names needs a column delay_ms"
        raise ValueError(f"{path}, line {number}: {cells[0]!r} is not a number; {allowed}")
    for place, second in enumerate(numbers[1:], start=2):
        if second is not None:
            raise ValueError(
                f"{path}, line {number}, column {place} = {cells[place - 1]}: a second number, and"
                " it is unclear which one is the delay; name the columns in the first line, with"
                " delay_ms"
            )
    if not 0.0 <= numbers[0] < math.inf:
        raise ValueError(f"{path}, line {number}: a delay is at least 0 and finite")
    yield numbers[0]


def _number(cell: str) -> float | None:
    try:
        return float(cell)
    except ValueError:
        return None


class Jitter:
    """A sequence of draws, in units of the channel's jitter (empirical ones: in ms).

    Attributes:
        mean: of the distribution.
    """

    def __init__(self, configuration: ChannelConfiguration, random: np.random.Generator) -> None:
        self._normal = endless(random.standard_normal)
        self._z = next(self._normal)
        self._correlation, self._keep, self._renew = 0.0, 0.0, 1.0
        self._quantile, self.mean = quantile_of(configuration)

    def draw(self, correlation: float) -> float:
        """The next draw, correlated like this with the one before."""
        if correlation != self._correlation:
            self._correlation = correlation
            self._keep = float(np.interp(correlation, *self._copula))
            self._renew = math.sqrt(1.0 - self._keep**2)
        self._z = self._keep * self._z + self._renew * next(self._normal)
        return self._quantile(self._z)

    @cached_property
    def _copula(self) -> tuple[Vector, Vector]:
        return copula_correlations(self._quantile)


def quantile_of(configuration: ChannelConfiguration) -> tuple[Quantile, float]:
    """Return the quantile function of a direction's jitter, and its mean.

    Raises:
        ValueError: its file of delays cannot be used.
    """
    if configuration.distribution_file is None:
        return QUANTILES[configuration.distribution], 0.0
    delays_ms = read_delays_ms(Path(configuration.distribution_file))
    return _empirical(delays_ms), float(delays_ms.mean())


def copula_correlations(quantile: Quantile) -> tuple[Vector, Vector]:
    """Correlations of draws, ascending from 0 to 1, and those of the normal numbers behind them.

    With g the quantile function at Φ(z), and c_k the coefficients of g in normalised Hermite
    polynomials, the correlation of g(z_1) and g(z_2) is Σ c_k² ρ^k / Σ c_k², k ≥ 1 (Mehler).
    """
    normal = np.linspace(0.0, 1.0, 401)
    values = elementwise(quantile, _Z)
    values -= _mean(values)
    variance = rest = _mean(values**2)
    if variance <= 0.0:
        return normal, normal
    drawn, power = np.zeros_like(normal), normal
    before, polynomial = np.zeros_like(_Z), np.ones_like(_Z)
    for k in range(1, _HERMITE_TERMS + 1):
        following = (_Z * polynomial - math.sqrt(k - 1) * before) / math.sqrt(k)
        before, polynomial = polynomial, following
        share = _mean(values * polynomial) ** 2
        drawn += share * power
        rest -= share
        power = power * normal
    drawn += max(rest, 0.0) * power
    return drawn / drawn[-1], normal


def _mean(values: Vector) -> float:
    """Expectation under the normal distribution, from values at `_Z`; not by @: its bits vary."""
    return float((_WEIGHTS * values).sum())


def _uniform(z: float) -> float:
    """Uniform between -1 and 1."""
    return math.erf(z / math.sqrt(2.0))


def _pareto(z: float) -> float:
    """Shape 3, mean 0, standard deviation 1. netem's table has 1.15 for the latter, cut at 4."""
    upper_tail = 0.5 * math.erfc(z / math.sqrt(2.0))
    return (math.pow(upper_tail, -1.0 / _PARETO_SHAPE) - _PARETO_MEAN) / _PARETO_DEVIATION


QUANTILES: dict[str, Quantile] = {"uniform": _uniform, "normal": float, "pareto": _pareto}
"""The distributions that need no file, by their names in the scenario."""


def _empirical(ascending: Vector) -> Quantile:
    values: list[float] = ascending.tolist()
    last = len(values) - 1

    def quantile(z: float) -> float:
        return values[min(int(0.5 * math.erfc(-z / math.sqrt(2.0)) * (last + 1)), last)]

    return quantile
