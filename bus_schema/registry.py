"""Registries of the classes behind the names in a scenario, each imported when first needed."""

from __future__ import annotations

from collections.abc import Mapping
from importlib import import_module
from typing import Generic, TypeVar, cast

from bus_schema.configuration import ConfigurationError
from bus_schema.errors import did_you_mean

T = TypeVar("T")


class Registry(Generic[T]):
    """Classes by name.

    Args:
        key: dotted key of the scenario whose value is one of the names.
        places: see below.

    Attributes:
        places: location of each name's class, as ``module:class``. A new entry registers a class of
            any module.
    """

    def __init__(self, key: str, places: Mapping[str, str]) -> None:
        self._key = key
        self.places = dict(places)

    @property
    def names(self) -> tuple[str, ...]:
        """All names, in the order of the table."""
        return tuple(self.places)

    def check(self, name: str) -> None:
        """Check that a name is registered.

        Raises:
            ConfigurationError: it is not.
        """
        if name not in self.places:
            *others, last = (repr(each) for each in self.names)
            allowed = f"must be {', '.join(others)} or {last}"
            raise ConfigurationError(self._key, name, allowed + did_you_mean(name, self.names))

    def load(self, name: str) -> type[T]:
        """Return the class behind a name.

        Raises:
            ConfigurationError: there is no such name.
        """
        self.check(name)
        module, attribute = self.places[name].split(":")
        return cast(type[T], getattr(import_module(module), attribute))

    def build(self, name: str) -> T:
        """Return an instance of the class behind a name, made without arguments.

        Raises:
            ConfigurationError: there is no such name.
        """
        return self.load(name)()
