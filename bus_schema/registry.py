"""Tables of what the names in a scenario stand for, each imported when it is first needed."""

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
        key: dotted key of the scenario that takes one of the names.
        places: see below.

    Attributes:
        places: where the class of each name is, as ``module:class``. One more entry is one more
            class, wherever it comes from.
    """

    def __init__(self, key: str, places: Mapping[str, str]) -> None:
        self._key = key
        self.places = dict(places)

    @property
    def names(self) -> tuple[str, ...]:
        """All names, in the order of the table."""
        return tuple(self.places)

    def check(self, name: str) -> None:
        """Check that there is such a name.

        Raises:
            ConfigurationError: there is none.
        """
        if name not in self.places:
            *others, last = (repr(each) for each in self.names)
            allowed = f"must be {', '.join(others)} or {last}"
            raise ConfigurationError(self._key, name, allowed + did_you_mean(name, self.names))

    def load(self, name: str) -> type[T]:
        """The class that a name stands for.

        Raises:
            ConfigurationError: there is no such name.
        """
        self.check(name)
        module, attribute = self.places[name].split(":")
        return cast(type[T], getattr(import_module(module), attribute))

    def build(self, name: str) -> T:
        """An instance of the class that a name stands for, made without arguments.

        Raises:
            ConfigurationError: there is no such name.
        """
        return self.load(name)()
