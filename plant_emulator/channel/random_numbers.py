"""Endless sequences of random numbers, drawn from a generator in blocks because that is cheap."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

_BLOCK = 256


def uniform_numbers(random: np.random.Generator) -> Iterator[float]:
    """Numbers from 0 to below 1."""
    while True:
        yield from random.random(_BLOCK).tolist()


def normal_numbers(random: np.random.Generator) -> Iterator[float]:
    """Numbers of mean 0 and standard deviation 1."""
    while True:
        yield from random.standard_normal(_BLOCK).tolist()
