"""Random generators of a run, and whether the run drew from them.

Everything random in a run comes from a generator of this module, or reports its draws to it. So a
study knows from a run whether another seed would change it.
"""

from __future__ import annotations

import random
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar

import numpy as np

_uses_of_run: ContextVar[list[Callable[[], bool]] | None] = ContextVar("uses", default=None)


@contextmanager
def noting_draws() -> Iterator[None]:
    """Note the draws of everything random that is created inside, in this thread."""
    token = _uses_of_run.set([])
    try:
        yield
    finally:
        _uses_of_run.reset(token)


def is_seed_used() -> bool | None:
    """Whether the run has used random numbers so far; None outside `noting_draws`."""
    uses = _uses_of_run.get()
    return None if uses is None else any(is_used() for is_used in uses)


def report_use(is_used: Callable[[], bool]) -> None:
    """Register a function that returns whether random numbers had an effect."""
    uses = _uses_of_run.get()
    if uses is not None:
        uses.append(is_used)


def generator(seed: np.random.SeedSequence) -> np.random.Generator:
    """Return a generator whose every draw counts."""
    numbers = np.random.default_rng(seed)
    start = numbers.bit_generator.state
    report_use(lambda: bool(numbers.bit_generator.state != start))
    return numbers


def plain_generator(seed: int) -> random.Random:
    """Return a generator of the standard library, likewise."""
    numbers = random.Random(seed)
    start = numbers.getstate()
    report_use(lambda: numbers.getstate() != start)
    return numbers
