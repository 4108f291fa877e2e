"""Tables of what the names in a scenario stand for, each imported when it is first needed."""

from __future__ import annotations

from collections.abc import Mapping
from importlib import import_module
from typing import Generic, TypeVar, cast

from bus_schema.configuration import ConfigurationError

T = TypeVar("T")


class Registry(Generic[T]):
    """Classes by name. A new one is one more line in the table, or one `register` from outside.

    Args:
        key: dotted key of the scenario that takes one of the names.
        places: where the class of each name is, as ``module:class``.
    """

    def __init__(self, key: str, places: Mapping[str, str]) -> None:
        self._key = key
        self._places = dict(places)

    @property
    def names(self) -> tuple[str, ...]:
        """All names, in the order of the table."""
        return tuple(self._places)

    def register(self, name: str, place: str) -> None:
        """Add a class, or put another one in place of the one that has the name."""
        self._places[name] = place

    def check(self, name: str) -> None:
        """Check that there is such a name.

        Raises:
            ConfigurationError: there is none.
        """
        if name not in self._places:
            *others, last = (repr(each) for each in self.names)
            allowed = f"must be {', '.join(others)} or {last}"
            raise ConfigurationError(self._key, name, allowed)

    def build(self, name: str) -> T:
        """An instance of the class that a name stands for.

        Raises:
            ConfigurationError: there is no such name.
        """
        self.check(name)
        module, attribute = self._places[name].split(":")
        return cast(T, getattr(import_module(module), attribute)())
