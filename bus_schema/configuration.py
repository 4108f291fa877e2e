"""Building blocks of validated configuration, shared by every room."""

from __future__ import annotations

from typing import Annotated, Any, TypeVar

import numpy as np
from pydantic import (
    AfterValidator,
    BaseModel,
    ConfigDict,
    Field,
    PlainSerializer,
    PlainValidator,
)

from bus_schema.arrays import Vector
from bus_schema.errors import BusError


class ConfigurationError(BusError, ValueError):
    """A value in a scenario cannot be used.

    Attributes:
        key: dotted key of the value.
        value: the value as given.
        allowed: what is allowed there.
    """

    def __init__(self, key: str, value: Any, allowed: str) -> None:
        super().__init__(f"{key} = {_shown(value)}: {allowed}")
        self.key = key
        self.value = value
        self.allowed = allowed


class StrictModel(BaseModel):
    """A configuration section: unknown keys are refused, values never change."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


def _to_vector(value: Any) -> Vector:
    given = value if isinstance(value, list | tuple | np.ndarray) else [value]
    values = [_number_in(v) if isinstance(v, str) else v for v in given]
    if any(isinstance(v, bool) or not isinstance(v, int | float | np.number) for v in values):
        raise ValueError("a number, or a list of numbers with one per joint")
    vector = np.array(values, dtype=np.float64)
    if vector.size == 0 or not np.all(np.isfinite(vector)):
        raise ValueError("finite numbers, one for all joints or one per joint")
    return vector


def _number_in(text: str) -> float | str:
    """YAML 1.1 takes 1e3 for a string; pydantic's own numbers are as forgiving."""
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

Positive = Annotated[float, Field(gt=0)]
NonNegative = Annotated[float, Field(ge=0)]
PowerAboveOne = Annotated[float, Field(gt=1)]
PowerBelowOne = Annotated[float, Field(gt=0, lt=1)]

Gains = TypeVar("Gains", bound=tuple[Any, ...])


def expand(value: Vector, joints: int, key: str) -> Vector:
    """One value per joint, shape (joints,), from one value for all or one for each.

    Raises:
        ConfigurationError: the number of values is neither 1 nor `joints`.
    """
    if value.size not in (1, joints):
        raise ConfigurationError(
            key, value.tolist(), f"one number, or one for each of the {joints} joints"
        )
    return np.ascontiguousarray(np.broadcast_to(value, (joints,)), dtype=np.float64)


def expand_fields(gains: Gains, joints: int, key: str) -> Gains:
    """A NamedTuple with every vector in it expanded to one value per joint."""
    values = {
        name: expand(value, joints, f"{key}.{name}")
        for name, value in gains._asdict().items()  # type: ignore[attr-defined]
        if isinstance(value, np.ndarray)
    }
    return gains._replace(**values)  # type: ignore[attr-defined,no-any-return]


def _shown(value: Any) -> str:
    text = repr(value)
    return text if len(text) <= 80 else text[:77] + "..."
