"""Extensions: what installed packages add by entry points of the groups ``funnel_hil.<kind>``."""

from __future__ import annotations

import logging
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cache
from importlib import metadata
from typing import Any

from bus_schema.errors import BusError

logger = logging.getLogger(__name__)
PREFIX = "funnel_hil."
"""All groups of entry points begin with this."""


class ExtensionError(BusError):
    """An extension cannot be loaded; the message names its package, group and reason."""


@dataclass(frozen=True)
class Extension:
    """An entry point of an installed package.

    Attributes:
        entry: the entry point: its name, group and location, ``module:attribute``.
        distribution: name of the package, as pip knows it.
        version: version of the package.
    """

    entry: metadata.EntryPoint
    distribution: str
    version: str

    def __str__(self) -> str:
        """Name the entry, its group and its package."""
        return f"{self.entry.name} ({self.entry.group}) of {self.distribution} {self.version}"

    def load(self) -> Any:
        """Import the module and return the attribute.

        Raises:
            ExtensionError: the import fails, or the module has no such attribute.
        """
        try:
            return self.entry.load()
        except (Exception, SystemExit) as error:  # code of a package may raise anything, or exit
            reason = f"{type(error).__name__}: {error}"
            raise ExtensionError(
                f"{self}: {self.entry.value} cannot be loaded: {reason}"
            ) from error


@cache
def installed() -> Mapping[str, Mapping[str, tuple[Extension, ...]]]:
    """Return all extensions by kind and name; several packages may add the same name.

    No package is imported. Files are read once per process, which takes 5 ms for 200 packages.
    """
    found: dict[str, dict[str, tuple[Extension, ...]]] = {}
    for each in sorted(_extensions(), key=lambda each: (each.entry.name, each.distribution)):
        named = found.setdefault(each.entry.group.removeprefix(PREFIX), {})
        named[each.entry.name] = (*named.get(each.entry.name, ()), each)
    return found


def _extensions() -> Iterator[Extension]:
    seen = set()
    for package in metadata.distributions():
        # `metadata.entry_points` parses the files of all packages, which takes three times as long.
        if PREFIX not in (package.read_text("entry_points.txt") or ""):
            continue
        name = str(package.metadata["Name"])
        if name in seen:  # an earlier folder of the search path has it too
            continue
        seen.add(name)
        try:
            entries = [each for each in package.entry_points if each.group.startswith(PREFIX)]
        except (ValueError, TypeError) as error:
            logger.warning("%s: its entry_points.txt cannot be read: %s", name, error)
            continue
        yield from (Extension(each, name, package.version) for each in entries)
