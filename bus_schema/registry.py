"""Tables of what a scenario can name: laws, faults, engines, …; installed packages add entries."""

from __future__ import annotations

from collections.abc import Container, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pkgutil import resolve_name
from typing import Any, Generic, TypeVar, cast

from pydantic import GetCoreSchemaHandler
from pydantic_core import CoreSchema, core_schema

from bus_schema.configuration import ConfigurationError
from bus_schema.errors import did_you_mean
from bus_schema.runtime.extensions import Extension, ExtensionError, installed

T = TypeVar("T")
_NONE = "left out: no installed package adds one"

REGISTRIES: dict[str, Registry[Any]] = {}
"""All registries that were created, by kind."""


@dataclass(frozen=True)
class NameIn:
    """For `Annotated`: the value is a name in the registry of this kind.

    Attributes:
        kind: key of `REGISTRIES`.
    """

    kind: str


@dataclass(frozen=True)
class KnownNameIn(NameIn):
    """Likewise, and a value that is no such name is refused when its section is read.

    Attributes:
        besides: further values.
    """

    besides: tuple[str, ...] = ()

    def __get_pydantic_core_schema__(self, of: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        return core_schema.no_info_after_validator_function(self._checked, handler(of))

    def _checked(self, name: str) -> str:
        registry = REGISTRIES[self.kind]
        if name not in (known := (*self.besides, *registry)):
            raise ValueError(f"one of {', '.join(known)}{did_you_mean(name, registry)}")
        return name


class Registry(Generic[T]):
    """One kind of extension: the entries that ship, and those that installed packages add.

    Iterating returns all names, first those that ship. Entries are imported when they are used. So
    a package that cannot be imported disturbs only the commands that use its entries.

    Args:
        kind: last part of the entry-point group, ``funnel_hil.<kind>``.
        key: dotted key of the scenario whose value is one of the names.
        entry: class of which each entry is an instance or a subclass.
        shipped: see below.

    Attributes:
        key: as above.
        shipped: the entries that ship, or their locations as ``module:attribute``.
    """

    def __init__(self, kind: str, key: str, entry: Any, shipped: Mapping[str, T | str]) -> None:
        self._kind, self.key, self._entry = kind, key, entry
        self.shipped = dict(shipped)
        REGISTRIES[kind] = self

    def __iter__(self) -> Iterator[str]:
        """Iterate over all names."""
        return iter(dict.fromkeys([*self.shipped, *self._added()]))

    def __contains__(self, name: object) -> bool:
        """Whether there is an entry of this name; it may be unusable."""
        return name in self.shipped or name in self._added()

    def __getitem__(self, name: str) -> T:
        """Return the entry of a name.

        Raises:
            ConfigurationError: there is none, or several, or it cannot be loaded.
        """
        self.check(name)
        added = self._added().get(name, ())
        if name in self.shipped and not added:
            found = self.shipped[name]
            return cast(T, resolve_name(found)) if isinstance(found, str) else found
        owners = [*(["funnel-hil itself"] if name in self.shipped else []), *map(str, added)]
        if len(owners) > 1:
            allowed = f"must be one thing, but {' and '.join(owners)} have it: uninstall one"
            raise ConfigurationError(self.key, name, allowed)
        try:
            return self._fitting(added[0].load(), added[0])
        except ExtensionError as error:
            raise ConfigurationError(self.key, name, str(error)) from error

    def check(self, name: str) -> None:
        """Check that a name is known.

        Raises:
            ConfigurationError: it is not.
        """
        if name not in self:
            *others, last = tuple(map(repr, self)) or (_NONE,)
            allowed = f"must be {', '.join(others)} or {last}" if others else f"must be {last}"
            raise ConfigurationError(self.key, name, allowed + did_you_mean(name, self))

    def usable(self, only: Container[str] | None = None) -> dict[str, T]:
        """Return the entries that can be loaded, by name.

        Args:
            only: names of the extensions to load besides what ships; None for all.
        """
        found = {}
        for name in self:
            if name in self.shipped or only is None or name in only:
                with suppress(ConfigurationError):
                    found[name] = self[name]
        return found

    def extension(self, name: str) -> Extension | None:
        """Return the origin of an entry that an installed package adds; None for what ships."""
        return None if name in self.shipped else next(iter(self._added().get(name, ())), None)

    def problem(self, name: str) -> str:
        """Return the reason why a known entry cannot be used; empty for none."""
        try:
            _ = self[name]
        except ConfigurationError as error:
            return error.allowed
        return ""

    def _added(self) -> Mapping[str, tuple[Extension, ...]]:
        return installed().get(self._kind, {})

    def _fitting(self, found: Any, extension: Extension) -> T:
        is_class = isinstance(found, type)
        if not (isinstance(found, self._entry) or (is_class and issubclass(found, self._entry))):
            wanted = f"{self._entry.__module__}.{self._entry.__qualname__}"
            allowed = f"must be an instance or a subclass of {wanted}"
            raise ExtensionError(f"{extension}: {extension.entry.value} {allowed}")
        return cast(T, found)


def extensions_in(scenario: Mapping[str, Any]) -> list[Extension]:
    """Return the extensions that a scenario names.

    Args:
        scenario: its values, in the form of its YAML file.
    """
    return [
        extension
        for registry in REGISTRIES.values()
        for name in _values_at(scenario, registry.key.split("."))
        if (extension := registry.extension(name)) is not None
    ]


def _values_at(values: Any, path: Sequence[str]) -> Iterator[Any]:
    """Return the values at a dotted key, those of lists each."""
    if isinstance(values, list):
        for each in values:
            yield from _values_at(each, path)
    elif not path:
        yield values
    elif isinstance(values, Mapping) and path[0] in values:
        yield from _values_at(values[path[0]], path[1:])
