"""Uncertain plants: the uncertainty of an arm, and arms drawn from it.

The section ``uncertainty`` of a scenario or a study gives the distribution of each number. A drawn
plant consists only of values of scenario keys, so it runs like any scenario. Every quantity has a
separate random stream, seeded by the seed, the plant's number and its keys: more plants, or more
quantities, do not change the existing ones.
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field, model_validator

from bus_schema.arrays import Vector, elementwise
from bus_schema.configuration import ConfigurationError, Number, StrictModel
from bus_schema.errors import did_you_mean
from deploy.scenario.yaml_files import leaves, override

_ROWS = "rows"
"""Name of the stream from which the number of the row is drawn."""
_NOT_DRAWN = ("seed", "uncertainty")
"""Keys with numbers that do not describe the plant."""


class Draw(StrictModel):
    """Distribution of one number, or of one for each joint.

    Attributes:
        distribution: ``uniform`` or ``log_uniform`` between ``from`` and ``to``, a ``choice`` of
            `values`, equally likely, a ``sign``, −1 or 1, or a ``row`` of `rows`.
        least: the smallest value; ``from`` in YAML.
        most: the largest value; ``to`` in YAML.
        values: values of a ``choice``.
        rows: values of each ``row``, one per joint with ``per: joint``, else one; all keys of a
            plant take the same row, so that their values belong together.
        per: one number for the whole ``arm``, or one for each ``joint``.
        relative: true: the draw is a factor on the scenario's own value; a dotted key: a factor on
            the value of that key.
        random_sign: whether the draw gets a random sign, with ``per: joint`` one for each.
    """

    distribution: Literal["uniform", "log_uniform", "choice", "sign", "row"]
    least: Annotated[Number | None, Field(alias="from")] = None
    most: Annotated[Number | None, Field(alias="to")] = None
    values: tuple[Number, ...] | None = None
    rows: Annotated[tuple[tuple[Number, ...], ...] | None, Field(min_length=1)] = None
    per: Literal["arm", "joint"] = "arm"
    relative: bool | str = False
    random_sign: bool = False

    @model_validator(mode="after")
    def _check(self) -> Draw:
        has_range = self.least is not None and self.most is not None
        has_ends = self.least is not None or self.most is not None
        if "uniform" in self.distribution:
            if not has_range or self.values is not None or not self.least < self.most:  # type: ignore[operator]
                raise ValueError(f"with from < to and without values if it is {self.distribution}")
            if self.distribution == "log_uniform" and not self.least > 0.0:  # type: ignore[operator]
                raise ValueError("with from > 0 if it is log_uniform")
        elif has_ends:
            raise ValueError(f"without from and to if it is {self.distribution}")
        elif (self.distribution == "row") != bool(self.rows):
            raise ValueError("with rows if it is row, otherwise without")
        elif (self.distribution == "choice") != bool(self.values):
            raise ValueError("with values if it is choice, otherwise without")
        if self.distribution == "sign" and self.random_sign:
            raise ValueError("without random_sign if it is sign")
        return self

    def sample(self, random: np.random.Generator, joints: int) -> float | Vector:
        """Draw from a stream: a number, or with ``per: joint`` shape (joints,)."""
        count = joints if self.per == "joint" else 1
        if self.rows:
            drawn = np.array(self.rows[random.integers(len(self.rows))])
            if drawn.size != count:
                raise ValueError(f"with {count} values in each row")
        elif self.distribution == "choice":
            drawn = random.choice(np.array(self.values), count)
        elif self.distribution == "sign":
            drawn = _signs(random, count)
        else:
            drawn = self._from_range(random, count)
        if self.random_sign:
            drawn = drawn * _signs(random, count)
        return drawn if self.per == "joint" else float(drawn[0])

    def _from_range(self, random: np.random.Generator, count: int) -> Vector:
        least, most = self.least or 0.0, self.most or 0.0  # `_check` ensures that both are given
        if self.distribution == "log_uniform":
            return elementwise(math.exp, random.uniform(math.log(least), math.log(most), count))
        return random.uniform(least, most, count)


Uncertainty = dict[str, Draw]
"""Draws by dotted key of the scenario; several keys, separated by commas, take the same draw."""


@dataclass(frozen=True)
class DrawnPlant:
    """One possible plant.

    Attributes:
        values: what is drawn, by dotted key of the scenario.
        draws: the random numbers themselves, factors for relative draws, by their keys in the form
            of `key_text`.
    """

    values: dict[str, float | list[float]]
    draws: dict[str, float | list[float]]

    @property
    def overrides(self) -> tuple[str, ...]:
        """Values as ``dotted.key=value``."""
        return tuple(override(key, value) for key, value in self.values.items())


def split_keys(text: str) -> tuple[str, ...]:
    """Split dotted keys that are separated by commas."""
    return tuple(key.strip() for key in text.split(","))


def key_text(text: str) -> str:
    """Return dotted keys that are separated by commas in a uniform notation."""
    return ", ".join(split_keys(text))


def check_uncertainty(uncertainty: Uncertainty, scenario: Mapping[str, Any], joints: int) -> None:
    """Check draws against their scenario.

    Args:
        uncertainty: the draws.
        scenario: the scenario's values, plain and nested.
        joints: number of the arm's joints.

    Raises:
        ConfigurationError: a key does not exist, or does not accept such a number.
    """
    keys = [key for text in uncertainty for key in split_keys(text)]
    for text in uncertainty:
        for key in split_keys(text):
            if keys.count(key) > 1:
                raise ConfigurationError(
                    f"uncertainty.{text}", key, "must be in the section only once"
                )
    draw_plant(uncertainty, scenario, joints, seed=0, number=1)


def draw_plant(
    uncertainty: Uncertainty, scenario: Mapping[str, Any], joints: int, *, seed: int, number: int
) -> DrawnPlant:
    """Draw one plant of a seed.

    Args:
        uncertainty: the draws.
        scenario: the scenario's values, plain and nested.
        joints: number of the arm's joints.
        seed: seed of all plants that belong together.
        number: number of the plant.

    Raises:
        ConfigurationError: as for `check_uncertainty`.
    """
    drawing = _Drawing(uncertainty, scenario, joints, (seed, number))
    values = {key: drawing.value(key) for key in drawing.keys}
    draws = {key_text(text): drawing.draws[text] for text in uncertainty}
    return DrawnPlant(
        {key: np.asarray(value).tolist() for key, value in values.items()},
        {text: np.asarray(drawn).tolist() for text, drawn in draws.items()},
    )


class _Drawing:
    """The values of one plant, each computed from those that it is relative to."""

    def __init__(
        self,
        uncertainty: Uncertainty,
        scenario: Mapping[str, Any],
        joints: int,
        seeds: tuple[int, int],
    ) -> None:
        self._uncertainty, self._scenario, self._joints = uncertainty, scenario, joints
        self.keys = {key: text for text in uncertainty for key in split_keys(text)}
        self.draws = {
            text: self._drawn(text, draw, _stream(*seeds, _ROWS if draw.rows else text))
            for text, draw in uncertainty.items()
        }
        self._open: list[str] = []

    def _drawn(self, text: str, draw: Draw, random: np.random.Generator) -> float | Vector:
        try:
            return draw.sample(random, self._joints)
        except ValueError as error:
            key, rows = f"uncertainty.{text}.rows", len(draw.rows or ())
            raise ConfigurationError(key, f"{rows} rows", f"must be {error}") from error

    def value(self, key: str) -> float | Vector:
        """Return the value of a drawn key."""
        text = self.keys[key]
        own, drawn, draw = self._own(key, text), self.draws[text], self._uncertainty[text]
        if isinstance(draw.relative, str):
            drawn = drawn * self._other(draw.relative, text)
        elif draw.relative:
            drawn = drawn * own
        if np.ndim(drawn) and not np.ndim(own):
            allowed = f"must be arm: {key} accepts one number, not one per joint"
            raise ConfigurationError(f"uncertainty.{text}", f"per: {draw.per}", allowed)
        return drawn

    def _other(self, key: str, text: str) -> float | Vector:
        """Return the value of a key that another one is relative to."""
        if key not in self.keys:
            return self._own(key, text, "relative")
        if key in self._open:
            circle = " → ".join([*self._open, key])
            raise ConfigurationError(f"uncertainty.{text}.relative", key, f"a circle: {circle}")
        self._open.append(key)
        value = self.value(key)
        self._open.pop()
        return value

    def _own(self, key: str, text: str, part: str | None = None) -> float | Vector:
        """Return the scenario's own value of a key."""
        where = f"uncertainty.{text}" + (f".{part}" if part else "")
        value = number_at(self._scenario, key) if _may_be_drawn(key) else None
        if value is None:
            drawn = (each for each in number_keys(self._scenario) if _may_be_drawn(each))
            allowed = "must be a key of the scenario that has a number"
            raise ConfigurationError(where, key, allowed + did_you_mean(key, drawn, 0.7))
        if np.ndim(value) and np.size(value) not in (1, self._joints):
            raise ConfigurationError(where, key, "must be a key with one number, or one per joint")
        return value


def number_at(scenario: Mapping[str, Any], key: str) -> float | Vector | None:
    """Return the number, or the numbers per joint, of a dotted key; None if there is none.

    Args:
        scenario: the scenario's values, plain and nested.
        key: dotted key.
    """
    found: Any = scenario
    for section in key.split("."):
        found = found.get(section) if isinstance(found, Mapping) else None
    entries = found if isinstance(found, list) and found else [found]
    if any(isinstance(entry, bool) or not isinstance(entry, int | float) for entry in entries):
        return None
    return np.array(found, dtype=np.float64) if isinstance(found, list) else float(entries[0])


def number_keys(scenario: Mapping[str, Any]) -> list[str]:
    """Return the dotted keys of all numbers of a scenario, including numbers per joint.

    Args:
        scenario: the scenario's values, plain and nested.
    """
    return [key for key, _ in leaves(scenario) if number_at(scenario, key) is not None]


def _may_be_drawn(key: str) -> bool:
    return key.split(".")[0] not in _NOT_DRAWN


def _signs(random: np.random.Generator, count: int) -> Vector:
    return np.where(random.uniform(size=count) < 0.5, -1.0, 1.0)


def _stream(seed: int, number: int, text: str) -> np.random.Generator:
    """Return the random stream of a quantity, independent of the order of its keys."""
    name = hashlib.sha256(",".join(sorted(split_keys(text))).encode()).digest()
    return np.random.default_rng([seed, number, int.from_bytes(name[:8], "little")])
