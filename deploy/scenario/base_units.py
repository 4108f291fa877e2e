"""Values of scenarios with a unit of their own, as ``2deg``, in the units of their keys."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Iterator, Mapping
from sys import float_info
from typing import Any

from bus_schema.foreign_text import shortened
from bus_schema.units import split_unit

_DEGREE = math.pi / 180.0
_ANGLES = {"deg": _DEGREE, "mrad": 1e-3, "rad": 1.0}
_LENGTHS = {"mm": 1e-3, "cm": 1e-2, "m": 1.0}
HELD = "rad or m"
"""Unit of the position of any joint."""
_SHARE = "share"
_SHARES = {
    "loss", "loss_in_bad", "loss_in_good", "mean_loss", "p", "r", "duplicate", "correlation",
    "share", "duty", "ask_when", "new_weight", "velocity_margin", "frame_error_probability",
}  # fmt: skip
"""Keys of shares and probabilities, besides those that end in ``_share``."""
_FACTORS: Mapping[str, Mapping[str, float]] = {
    "rad": _ANGLES,
    "rad/s": {f"{unit}/s": factor for unit, factor in _ANGLES.items()},
    "rad/s²": {f"{unit}/s2": factor for unit, factor in _ANGLES.items()},
    "m": _LENGTHS,
    "m/s": {f"{unit}/s": factor for unit, factor in _LENGTHS.items()},
    HELD: _ANGLES | _LENGTHS,
    _SHARE: {"%": 0.01},
}
"""By the unit of a key: the units that its values may have."""
_WORDS = {
    "°": "deg", "degree": "deg", "degrees": "deg", "radian": "rad", "radians": "rad",
    "millimetre": "mm", "millimetres": "mm", "millimeter": "mm", "millimeters": "mm",
    "centimetre": "cm", "centimetres": "cm", "centimeter": "cm", "centimeters": "cm",
    "metre": "m", "metres": "m", "meter": "m", "meters": "m",
}  # fmt: skip
"""Other spellings of a unit, or of its first part."""
_POSES = ("robot", "hold")
"""Each of these keys is the name of a joint."""
_NUMBER = r"([+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?)"
_QUANTITY = re.compile(rf"{_NUMBER}\s*(%|[A-Za-z°][\w/]*)")
_WITH_ANY_UNIT = re.compile(rf"\s*{_NUMBER}\s*[^\d\s.,eE+-]")


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
    unit = HELD if path[:-1] == _POSES else _unit_of(path[-1])
    return in_unit(value, unit) if isinstance(value, str) else value


def _unit_of(key: str) -> str:
    is_share = key in _SHARES or key.endswith("_share")
    return _SHARE if is_share else split_unit(f"_{key}")[1]


def in_unit(text: str, unit: str) -> float | str:
    """Return a number with a unit in the unit of its key; any other text as it is.

    Args:
        text: as ``2deg``.
        unit: as in `bus_schema.units`, or `HELD`.
    """
    found = _QUANTITY.fullmatch(text.strip())
    factor = None if found is None else _FACTORS.get(unit, {}).get(_short(found[2]))
    if found is None or factor is None:
        return text
    number = float(found[1])
    return number / 100.0 if unit == _SHARE else number * factor  # 35% is 0.35 to the bit


def with_unit_of_key(unknown: str, value: Any, known: Iterable[str]) -> tuple[str, str] | None:
    """Return a known key and a value for it, where an unknown key is that key in another unit.

    Args:
        unknown: as ``offset_deg``.
        value: the value that it was given.
        known: keys, as ``offset_rad``.
    """
    for key in known:
        stem, of_key = split_unit(key)
        for unit in _FACTORS.get(of_key, {}):
            if unknown in {f"{stem}_{each}" for each in _spellings(unit)}:
                texts = [_written(it, unit, of_key) for it in _listed(value)]
                if not all(texts) or not texts:
                    return None
                joined = ", ".join(texts)
                return key, shortened(f"[{joined}]" if isinstance(value, list) else joined)
    return None


def _written(value: Any, unit: str, of_key: str) -> str:
    """Write a value of a key in a unit; empty unless it is a finite number, or has a unit."""
    if isinstance(value, str):
        number = in_unit(value, of_key)
        is_number = isinstance(number, float) and math.isfinite(number)
        return "".join(value.split()) if is_number else ""
    is_finite = type(value) in (int, float) and abs(value) <= float_info.max
    return f"{value}{unit}" if is_finite else ""


def _listed(value: Any) -> list[Any]:
    return value if isinstance(value, list) else [value]


def hint_of_unit(key: str, value: Any) -> str:
    """Say how a number with a unit, or a percentage, is written for a key; else empty."""
    texts = [each for each in _listed(value) if type(each) is str]
    found = next(filter(None, map(_WITH_ANY_UNIT.match, texts)), None)
    unit = _unit_of(key)
    if unit == _SHARE and type(value) in (int, float) and 1 < value <= 100:
        return f"; {value:g} % is written {value / 100:g} or {value:g}%"
    if found is None or not unit or not math.isfinite(float(found[1])):
        return ""
    if unit not in _FACTORS:
        return f"; write the number alone, in {unit}"
    return f"; write {' or '.join(f'{shortened(found[1])}{each}' for each in _FACTORS[unit])}"


def _short(unit: str) -> str:
    first, slash, rest = unit.partition("/")
    return f"{_WORDS.get(first, first)}{slash}{rest}"


def _spellings(unit: str) -> Iterator[str]:
    """Return a unit as the end of a key: ``deg``, ``degrees``, ``deg_s``."""
    first, _, rest = unit.partition("/")
    for each in (first, *(word for word, short in _WORDS.items() if short == first)):
        yield f"{each}_{rest}" if rest else each
