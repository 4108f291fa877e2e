"""The one number to quote of a case: the smallest of the margins found for it."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from enum import StrEnum
from typing import Any

Found = Mapping[str, Any]


class Because(StrEnum):
    """Reason why a number is the one to quote: the test that supports no larger one."""

    HELD = "held"
    THEORY = "theory"
    PATTERN = "every pattern"
    ROTORS = "smaller rotors"
    MODEL = "model error"


def quoted(case: Found, *, is_over: bool = True) -> dict[str, Any]:
    """Return the smallest margin found for a case, and why, for a summary.

    Args:
        case: what was found of it.
        is_over: whether its search and all that is tried after it are over.

    Returns:
        ``quoted``: the number, in the unit of the quantity; null for none. ``quoted_because``: a
        `Because`; null while it is not over.
    """
    if not is_over:
        return {"quoted": None, "quoted_because": None}
    known = list(_known(case))
    none = next((because for number, because in known if number is None), None)
    if none is not None:
        return {"quoted": None, "quoted_because": none.value}
    number, because = min(known, key=lambda each: case["growth"] * each[0])
    return {"quoted": number, "quoted_because": because.value}


def _known(case: Found) -> Iterator[tuple[Any, Because]]:
    """Return each margin that is known, and what knows it; None where nothing holds."""
    yield case["margin"], Because.HELD
    theory = case.get("theory") or {}
    if theory.get("unstable_without_delay") is not None:
        yield None, Because.THEORY
    elif "constant_ms" in theory:
        yield max(0.0, round(theory["constant_ms"] - theory["beside_ms"], 9)), Because.THEORY
    if (worst := case.get("worst_pattern")) is not None:
        yield worst["margin"], Because.PATTERN
    if (smaller := case.get("smaller_rotors")) is not None:
        yield smaller["margin"], Because.ROTORS
    for each in case.get("model_errors") or ():
        yield each["margin"], Because.MODEL
