"""Endless sequences of random numbers, drawn from a generator in blocks because that is cheap."""

from __future__ import annotations

from collections.abc import Callable, Iterator

from bus_schema.arrays import Vector

_BLOCK = 256


def endless(draw: Callable[[int], Vector]) -> Iterator[float]:
    """Numbers one by one from a method of a generator that draws as many as it is told to."""
    while True:
        yield from draw(_BLOCK).tolist()
