"""Causes of different last bits in a run: the C library's functions, and versions of libraries."""

from __future__ import annotations

import hashlib
import math
import struct
from collections.abc import Callable, Mapping
from functools import cache
from typing import Any

_POINTS = 1000
_DIGITS = 12
_COMPUTING = ("pybullet", "mujoco", "pin", "numpy", "numba")
"""Libraries whose numbers affect a torque; others only transport, store or show them."""

# Each takes numbers between 0 and 1. glibc has variants with and without FMA, chosen by CPU.
_FUNCTIONS: tuple[Callable[[float], float], ...] = (
    lambda x: math.sin(20.0 * x),
    lambda x: math.cos(20.0 * x),
    lambda x: math.exp(20.0 * x - 10.0),
    lambda x: math.log(x),
    lambda x: math.tanh(4.0 * x),
    lambda x: math.pow(3.0 * x, 1.4),
    lambda x: math.atan2(x, 0.3),
    lambda x: math.acos(x),
    lambda x: math.cosh(4.0 * x),
    lambda x: math.erf(2.0 * x),
    lambda x: math.erfc(2.0 * x),
    lambda x: math.log1p(-x),
)


@cache
def libm_fingerprint() -> str:
    """Return a hash of this machine's C library's results in Python, compiled code and physics."""
    points = [(k + 0.5) / _POINTS for k in range(_POINTS)]
    values = [function(x) for function in _FUNCTIONS for x in points]
    return hashlib.sha256(struct.pack(f"<{len(values)}d", *values)).hexdigest()[:_DIGITS]


def difference_of_arithmetic(one: Mapping[str, Any], other: Mapping[str, Any]) -> str:
    """Explain in a sentence why two runs may differ in their last bits; empty if unknown.

    Args:
        one: manifest of a run.
        other: manifest of the other; values missing in either are ignored.
    """
    first, second = _computing(one), _computing(other)
    found = [
        f"{name} {first[name]} and {second[name]}"
        for name in ("libm", *_COMPUTING)
        if first.get(name) and second.get(name) and first[name] != second[name]
    ]
    if not found:
        return ""
    return f"The arithmetic differs ({', '.join(found)}), which may change the last bits."


def _computing(manifest: Mapping[str, Any]) -> dict[str, Any]:
    """Return the fingerprint of the C library, and versions, as far as they are there."""
    sections = (manifest.get(name) for name in ("versions", "arithmetic"))
    return {k: v for each in sections if isinstance(each, Mapping) for k, v in each.items()}
