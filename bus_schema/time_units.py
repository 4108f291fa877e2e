"""Units of times in tables: the name of a column says it, or the user."""

from __future__ import annotations

import re
from collections.abc import Sequence
from enum import StrEnum

import numpy as np

from bus_schema.arrays import Vector
from bus_schema.errors import InputError

UNITS_MS = {"s": 1e3, "ms": 1.0, "us": 1e-3, "ns": 1e-6}
_SUFFIX = re.compile(r"(?:_|\s*[\[(])([mnuµμ]?)s(?:ec)?[\])]?$", re.IGNORECASE)
_PREFIXES = {"µ": "u", "μ": "u"}
_SHORTEST_S, _LONGEST_S = 10e-6, 10.0


def unit_of(column: str, otherwise: str) -> str:
    """Return the unit of a column's times, as ``us`` of ``delay_us`` or ``delay [µs]``.

    Args:
        column: its name.
        otherwise: the unit where the name has none.
    """
    return split_unit(column)[1] or otherwise


def split_unit(column: str) -> tuple[str, str]:
    """Return the words of a column's name in lower case, and its unit; an empty one for none."""
    found = _SUFFIX.search(column)
    words = column if found is None else column[: found.start()]
    prefix = "" if found is None else found[1].lower()
    unit = "" if found is None else f"{_PREFIXES.get(prefix, prefix)}s"
    return re.sub(r"[\s-]+", "_", words.strip().lower()), unit


def units_of(columns: Sequence[str], given: str | None, option: str) -> dict[str, str]:
    """Return the units of columns: those that their names say, else the one that the user gave.

    Args:
        columns: their names.
        given: the user's unit; None for seconds.
        option: the option that gives it.

    Raises:
        InputError: all names say units, and another than the user gave.
    """
    named = {name: unit_of(name, "") for name in columns}
    if given is not None and all(named.values()) and set(named.values()) != {given}:
        said = ", ".join(f"{name} is in {unit}" for name, unit in named.items())
        raise InputError(f"{option} {given}: must be left out, as by their names {said}")
    return {name: unit or given or "s" for name, unit in named.items()}


def check_interval(times_s: Vector) -> None:
    """Refuse times that are in another unit than they seem to be.

    Raises:
        ValueError: messages are usually less than 10 µs apart, or more than 10 s.
    """
    median_s = float(np.median(np.diff(times_s))) if len(times_s) > 1 else _SHORTEST_S
    if not _SHORTEST_S <= median_s <= _LONGEST_S:
        raise ValueError(
            f"the times are usually {median_s:.3g} s apart, must be {1e6 * _SHORTEST_S:g} µs to"
            f" {_LONGEST_S:g} s: is their unit another?"
        )


class Unit(StrEnum):
    """Units of times."""

    S = "s"
    MS = "ms"
    US = "us"
    NS = "ns"
