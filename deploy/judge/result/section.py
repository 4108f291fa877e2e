"""Declaration of figures: type, meaning, unit and column of each in one place.

A figure is a field of a `Section`. The docstring of the section explains it, its name ends with its
unit, and a `Column` in its annotation puts it in the tables of runs. ``summary.json``, Parquet
files and the published reference read these declarations.
"""

from __future__ import annotations

import inspect
from collections.abc import Iterator
from dataclasses import dataclass, replace
from types import NoneType
from typing import Any, ClassVar, NamedTuple, get_args, get_origin

from pydantic import BaseModel, ConfigDict, SerializerFunctionWrapHandler, model_serializer

PerJoint = list[float]
"""A value for each joint, in the order of ``tracking.joint_names``."""
Spread = dict[str, Any]
"""Percentiles by name, and the mean where there is one; None where there are no values."""

_KINDS = {float: "double", int: "int64", bool: "bool"}


@dataclass(frozen=True)
class Column:
    """For `Annotated`: the figure is a column of tables of runs.

    Attributes:
        name: name of the column, where ``{}`` is the figure's name; of a section: a pattern for the
            names of its columns; of a `Spread` where ``{}`` is the name of an entry.
        of_any_part: whether a run has it that ended at its loss; the others are for whole runs.
        kind: its Parquet type, if that does not follow from the type of the figure.
        entries: names of the entries of a `Spread`, which are a column each.
    """

    name: str = "{}"
    of_any_part: bool = False
    kind: str = ""
    entries: tuple[str, ...] = ()


class Section(BaseModel):
    """Base of the result of a run, and of its parts.

    ``model_dump`` returns its content for ``summary.json``.

    Attributes:
        only_sometimes: figures that ``summary.json`` has only where they are not None.
    """

    model_config = ConfigDict(frozen=True, extra="forbid", defer_build=True)
    only_sometimes: ClassVar[frozenset[str]] = frozenset()

    @model_serializer(mode="wrap")
    def _leave_out(self, handler: SerializerFunctionWrapHandler) -> dict[str, Any]:
        found = handler(self)
        return {k: v for k, v in found.items() if v is not None or k not in self.only_sometimes}


class Figure(NamedTuple):
    """A figure of a result, or a part of the result.

    Attributes:
        path: keys of its value, from the outside; ``name[]`` for each entry of a list.
        section: the class whose docstring explains it.
        is_part: whether it is a part of the result, with figures of its own.
        column: its column, named in full; None for none.
    """

    path: tuple[str, ...]
    section: type[Section]
    is_part: bool
    column: Column | None

    @property
    def kind(self) -> str:
        """The Parquet type of its columns; empty for none."""
        return "" if self.column is None else self.column.kind

    @property
    def is_of_any_part(self) -> bool:
        """Whether a run has it that ended at its loss."""
        return self.column is not None and self.column.of_any_part

    @property
    def columns(self) -> dict[str, tuple[str, ...]]:
        """Names of its columns, with the keys of their values."""
        if self.column is None:
            return {}
        name, entries = self.column.name, self.column.entries
        return {name.format(e): (*self.path, e) for e in entries} or {name: self.path}


def figures(
    section: type[Section], outer: tuple[str, ...] = (), pattern: str = "{}"
) -> Iterator[Figure]:
    """Return all figures of a section, and those of its parts behind each part.

    Args:
        section: the section.
        outer: keys of the section.
        pattern: of the names of its columns; empty for no columns.
    """
    for name, field in section.model_fields.items():
        hint, path = field.annotation, (*outer, name)
        own = next((each for each in field.metadata if isinstance(each, Column)), None)
        inner = next((each for each in (hint, *get_args(hint)) if _is_section(each)), None)
        is_part = inner is not None and get_origin(hint) is not list
        if own is None or is_part or not pattern:
            yield Figure(path, section, is_part, None)
        else:
            named, kind = (
                own.name if own.entries else own.name.format(name),
                own.kind or _kind(hint),
            )
            column = replace(own, name=pattern.format(named), kind=kind)
            yield Figure(path, section, is_part, column)
        if inner is not None and is_part:
            yield from figures(inner, path, "{}" if own is None else own.name)
        elif inner is not None:
            yield from figures(inner, (*outer, f"{name}[]"), "")


def _is_section(hint: Any) -> bool:
    return inspect.isclass(hint) and issubclass(hint, Section)


def _kind(hint: Any) -> str:
    """Return the Parquet type of a figure by its type."""
    plain = next((each for each in get_args(hint) if each is not NoneType), None)
    if get_origin(hint) in (list, dict):
        return f"list<{_kind(plain)}>" if get_origin(hint) is list else "double"
    return _KINDS.get(hint, "string") if plain is None else _kind(plain)
