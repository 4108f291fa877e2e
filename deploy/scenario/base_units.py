"""Values of scenarios with a unit of their own, as ``2deg``, in the units of their keys."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from typing import Any

from bus_schema.units import split_unit

_DEGREE = math.pi / 180.0
_ANGLES = {"deg": _DEGREE, "mrad": 1e-3, "rad": 1.0}
_LENGTHS = {"mm": 1e-3, "cm": 1e-2, "m": 1.0}
HELD = "rad or m"
"""Unit of the position of any joint."""
_FACTORS: Mapping[str, Mapping[str, float]] = {
    "rad": _ANGLES,
    "rad/s": {f"{unit}/s": factor for unit, factor in _ANGLES.items()},
    "rad/s²": {f"{unit}/s2": factor for unit, factor in _ANGLES.items()},
    "m": _LENGTHS,
    "m/s": {f"{unit}/s": factor for unit, factor in _LENGTHS.items()},
    HELD: _ANGLES | _LENGTHS,
}
"""By the unit of a key: the units that its values may have."""
_POSES = ("robot", "hold")
"""Each of these keys is the name of a joint."""
_QUANTITY = re.compile(r"([+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?)\s*([A-Za-z][\w/]*)")


def in_base_units(values: Mapping[str, Any]) -> dict[str, Any]:
    """Return values of a scenario with each number and unit replaced by a number.

    Values whose unit does not fit their key stay texts, which the scenario's schema refuses.

    Args:
        values: in the form of its YAML file.
    """
    return {key: _converted(value, (key,)) for key, value in values.items()}


def _converted(value: Any, path: tuple[str, ...]) -> Any:
    if isinstance(value, Mapping):
        return {key: _converted(inner, (*path, str(key))) for key, inner in value.items()}
    if isinstance(value, list):
        return [_converted(inner, path) for inner in value]
    unit = HELD if path[:-1] == _POSES else split_unit(f"_{path[-1]}")[1]
    return in_unit(value, unit) if isinstance(value, str) else value


def in_unit(text: str, unit: str) -> float | str:
    """Return a number with a unit in the unit of its key; any other text as it is.

    Args:
        text: as ``2deg``.
        unit: as in `bus_schema.units`, or `HELD`.
    """
    found = _QUANTITY.fullmatch(text.strip())
    factor = None if found is None else _FACTORS.get(unit, {}).get(found[2])
    return text if found is None or factor is None else float(found[1]) * factor
