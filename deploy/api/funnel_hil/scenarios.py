"""Scenarios and laws as Python has them: names, files, dictionaries, classes, objects."""

from __future__ import annotations

import copy
import re
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from bus_schema.errors import InputError
from controller.control_law import ControlLaw, Diagnostics, Dynamics, Tracking
from controller.demonstrator import Demonstrator
from controller.laws.custom import Maker, laws_given
from deploy.scenario.effective import effective_values
from deploy.scenario.referenced_files import data_files
from deploy.scenario.scenario import SHIPPED, build_setup, given_values, named_values
from deploy.scenario.setup import Setup
from deploy.scenario.study_keys import LAW
from deploy.scenario.yaml_files import ScenarioError, override, plain, set_value, to_yaml

__all__ = [
    "ControlLaw", "Demonstrator", "Diagnostics", "Dynamics", "InputError", "Law", "Scenario",
    "ScenarioLike", "Tracking", "named_law", "scenarios",
]  # fmt: skip

Law = str | Maker | ControlLaw
"""A shipped law or a ``module:Class`` by name; a class or function that makes a law from the
nominal model and its gains; or a law, of which every run gets a copy."""

Changes = Mapping[str, Any]
"""Values of a scenario by dotted key (``{"link.uplink.delay_ms": 8}``), or by section."""


def scenarios() -> list[str]:
    """Names of the shipped scenarios."""
    return sorted(file.stem for file in SHIPPED.glob("*.yaml"))


class Scenario:
    """A scenario, checked as a whole.

    Args:
        source: the name of a shipped scenario, a file, a dictionary as such a file holds one (it
            may ``extends`` another one), or another scenario.
        changes: what is set in it.
        law: what to control it with; the scenario's own by default.

    Attributes:
        name: of the scenario.
        law: name of the law; ``module:Class`` for one of your own.
        joint_names: of the arm.
        values: every value in force: defaults, changes, derived gains and limits.

    Raises:
        InputError: anything about it is wrong; the message names key, value and what is allowed.
    """

    overrides: tuple[str, ...]
    _values: Mapping[str, Any]
    _file: Path

    def __init__(
        self, source: ScenarioLike = "paper_arm", changes: Changes | None = None,
        law: Law | None = None,
    ) -> None:  # fmt: skip
        self.makers: dict[str, Maker] = {}
        before: tuple[str, ...] = ()
        if isinstance(source, Scenario):
            self._values, self._file = source._values, source._file
            self.makers, before = dict(source.makers), source.overrides
        elif isinstance(source, Mapping):
            self._values, self._file = plain(dict(source)), Path("scenario")
        else:
            self._file, self._values = named_values(str(source))
        flat = dict(_leaves(changes or {}))
        if law is not None:
            flat[LAW], makers = named_law(law)
            self.makers |= makers
        self.overrides = (*before, *(override(key, value) for key, value in flat.items()))
        self.setup  # noqa: B018  (raises errors of the scenario now)

    def __repr__(self) -> str:
        return f"<Scenario {self.name}, {self.law}, {self.setup.scenario.duration_s:g} s>"

    @cached_property
    def setup(self) -> Setup:
        """The scenario, loaded and checked."""
        with self.laws():
            return build_setup(self._values, self._file, self.overrides, "changes")

    @property
    def name(self) -> str:
        return self.setup.scenario.name

    @property
    def law(self) -> str:
        return self.setup.scenario.controller.law

    @property
    def joint_names(self) -> tuple[str, ...]:
        return self.setup.robot.joint_names

    @property
    def values(self) -> dict[str, Any]:
        return effective_values(self.setup)

    def to_yaml(self) -> str:
        """Return it as a scenario file with absolute paths, without derived values."""
        values = given_values(self._values, self._file, self.overrides)
        set_value(values, "robot.urdf", str(self.setup.robot.path))
        for key, file in data_files(self.setup.scenario).items():
            set_value(values, key, str(file))
        return to_yaml(values)

    @contextmanager
    def laws(self) -> Iterator[None]:
        """Meanwhile the names of its laws stand for the classes or objects that were given."""
        with laws_given(self.makers):
            yield


ScenarioLike = str | Path | Mapping[str, Any] | Scenario


def named_law(law: Law) -> tuple[str, dict[str, Maker]]:
    """The name of a law in scenarios, and what makes it, where it is given as more than a name.

    Raises:
        ScenarioError: it is none.
    """
    if isinstance(law, str):
        return law, {}
    if callable(law):
        return (name := _name_of(law)), {name: law}
    if not (callable(getattr(law, "torque", None)) and callable(getattr(law, "reset", None))):
        raise ScenarioError(
            f"law = {law!r}: must be a name, a class, or an object with torque, reset, diagnostics"
        )
    made = law

    def a_copy(_model: object) -> ControlLaw:
        return copy.deepcopy(made)

    return (name := _name_of(type(law))), {name: a_copy}


def _name_of(law: Any) -> str:
    """``module:Class``."""
    name = re.sub(r"\W", "_", getattr(law, "__name__", type(law).__name__))
    return f"{getattr(law, '__module__', '__main__')}:{name}"


def _leaves(given: Mapping[str, Any], before: str = "") -> Iterator[tuple[str, Any]]:
    """Values by dotted key, as plain ones that YAML has."""
    for key, value in given.items():
        whole = f"{before}{key}" == "reference" and "kind" in value  # takes the place of any other
        if isinstance(value, Mapping) and not whole:
            yield from _leaves(value, f"{before}{key}.")
        else:
            yield f"{before}{key}", _plain(value)


def _plain(value: Any) -> Any:
    """Arrays, numbers of NumPy and paths as YAML has them."""
    if isinstance(value, np.generic | np.ndarray):
        return value.tolist()
    if isinstance(value, Path):
        return str(value)
    return plain(value)
