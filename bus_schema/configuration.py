"""Building blocks of validated configuration, shared by every room."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Iterable, Sequence
from dataclasses import dataclass
from typing import Annotated, Any, TypeVar

import numpy as np
from pydantic import (
    AfterValidator,
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    PlainSerializer,
    PlainValidator,
    ValidationError,
)

from bus_schema.arrays import Vector
from bus_schema.errors import BusError
from bus_schema.foreign_text import shown as shown


class ConfigurationError(BusError, ValueError):
    """A value in a scenario cannot be used.

    Attributes:
        key: dotted key of the value.
        value: the value as given.
        allowed: what is allowed there.
        beside: dotted keys of other values or sections that conflict with this one.
    """

    def __init__(self, key: str, value: Any, allowed: str, beside: Sequence[str] = ()) -> None:
        super().__init__(f"{key} = {shown(value)}: {allowed}")
        self.key = key
        self.value = value
        self.allowed = allowed
        self.beside = beside


class SettingsError(ConfigurationError):
    """Settings of an extension have wrong keys or values.

    Attributes:
        section: dotted key of the settings.
        error: what pydantic says.
        model: the class of the settings.
    """

    def __init__(self, key: str, error: ValidationError, model: type[BaseModel]) -> None:
        first = error.errors(include_url=False)[0]
        name = ".".join([key, *map(str, first["loc"])])
        super().__init__(name, first["input"], f"invalid: {first['msg']}")
        self.section, self.error, self.model = key, error, model


class StrictModel(BaseModel):
    """A configuration section: unknown keys are refused, values never change."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False, defer_build=True)


@dataclass(frozen=True)
class Sections:
    """For `Annotated`, where a function validates a value: the classes that define its keys.

    Attributes:
        find: returns the classes that ship, and those of the given extensions; None for all.
    """

    find: Callable[[Collection[str] | None], Iterable[type]]


LARGEST = 1e12
"""Largest absolute value of a number: results computed from a larger one would overflow."""


def _not_boolean(value: Any) -> Any:
    """Reject booleans, which pydantic accepts as 0 and 1."""
    if isinstance(value, bool):
        raise ValueError("a number, not true or false (in YAML also yes, no, on, off)")  # noqa: TRY004 (pydantic takes these alone)
    return value


def _to_vector(value: Any) -> Vector:
    given = value if isinstance(value, list | tuple | np.ndarray) else [value]
    values: list[Any] = [_number_in(v) if isinstance(v, str) else v for v in given]
    if any(isinstance(v, bool) or not isinstance(v, int | float | np.number) for v in values):
        raise ValueError("a number, or a list of numbers with one per joint")
    if not values or not all(-math.inf < v < math.inf for v in values):
        raise ValueError("finite numbers, one for all joints or one per joint")
    if any(abs(v) > LARGEST for v in values):  # of which an int may be too large for an array
        raise ValueError(f"numbers of at most {LARGEST:g} in size")
    return np.array(values, dtype=np.float64)


def _number_in(text: str) -> float | str:
    """Parse a number; YAML 1.1 reads 1e3 as a string, and pydantic accepts that too."""
    try:
        return float(text)
    except ValueError:
        return text


def _require_positive(vector: Vector) -> Vector:
    if np.any(vector <= 0.0):
        raise ValueError("numbers above 0")
    return vector


def _require_non_negative(vector: Vector) -> Vector:
    if np.any(vector < 0.0):
        raise ValueError("numbers of at least 0")
    return vector


PerJoint = Annotated[
    Vector,
    PlainValidator(_to_vector),
    PlainSerializer(lambda vector: vector.tolist(), return_type=list[float]),
]
PerJointPositive = Annotated[PerJoint, AfterValidator(_require_positive)]
PerJointNonNegative = Annotated[PerJoint, AfterValidator(_require_non_negative)]

Number = Annotated[float, BeforeValidator(_not_boolean), Field(ge=-LARGEST, le=LARGEST)]
Whole = Annotated[int, BeforeValidator(_not_boolean)]
Positive = Annotated[Number, Field(gt=0)]
NonNegative = Annotated[Number, Field(ge=0)]
PowerAboveOne = Annotated[Number, Field(gt=1)]
PowerBelowOne = Annotated[Number, Field(gt=0, lt=1)]

Gains = TypeVar("Gains", bound=tuple[Any, ...])
Settings = TypeVar("Settings", bound=BaseModel)


def validated(key: str, settings: type[Settings], values: Any) -> Settings:
    """Return the settings of an extension from the values of a scenario.

    Args:
        key: dotted key of the values.
        settings: class of the settings.
        values: a mapping, as in the scenario.

    Raises:
        SettingsError: keys or values are wrong.
    """
    try:
        return settings.model_validate(values)
    except ValidationError as error:
        raise SettingsError(key, error, settings) from error


def expand(value: Vector, joints: int, key: str) -> Vector:
    """Return one value per joint, shape (joints,), from one value for all or one for each.

    Raises:
        ConfigurationError: the number of values is neither 1 nor `joints`.
    """
    if value.size not in (1, joints):
        raise ConfigurationError(
            key, value.tolist(), f"one number, or one for each of the {joints} joints"
        )
    return np.array(np.broadcast_to(value, (joints,)), dtype=np.float64)


def expand_fields(gains: Gains, joints: int, key: str) -> Gains:
    """Return a NamedTuple with every vector expanded to one value per joint."""
    values = {
        name: expand(value, joints, f"{key}.{name}")
        for name, value in gains._asdict().items()  # type: ignore[attr-defined]
        if isinstance(value, np.ndarray)
    }
    return gains._replace(**values)  # type: ignore[attr-defined,no-any-return]
