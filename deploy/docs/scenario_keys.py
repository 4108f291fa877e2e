"""Tables of the keys of a scenario, written from its sections."""

from __future__ import annotations

import inspect
import re
import types
from collections.abc import Iterator
from typing import Annotated, Any, Literal, Union, get_args, get_origin, get_type_hints

import numpy as np
from pydantic import BaseModel

from bus_schema.configuration import Sections
from bus_schema.registry import REGISTRIES, NameIn
from deploy.docs.reference_words import attributes_of, meanings, table, unit_of

PLAIN = {bool: "true or false", int: "whole number", float: "number", str: "text", Any: "anything",
         types.NoneType: "must be left out"}  # fmt: skip
BOUNDS = {"gt": ">", "ge": "≥", "lt": "<", "le": "≤"}
PER_JOINT = {"_require_positive": ", > 0", "_require_non_negative": ", ≥ 0"}


def values_of(hint: Any) -> str:
    """Return the values that a type allows, in words."""
    origin, parts = get_origin(hint), get_args(hint)
    if origin is Annotated:
        if named := [each for each in parts if isinstance(each, NameIn)]:
            return ", ".join(f"`{name}`" for name in REGISTRIES[named[0].kind].shipped)
        return values_of(parts[0]) + "".join(_limits(each) for each in parts[1:])
    if origin is Literal:
        return ", ".join(f"`{each}`" for each in parts)
    if origin in (Union, types.UnionType):
        return " or ".join(dict.fromkeys(values_of(p) for p in parts if p is not types.NoneType))
    if origin in (tuple, list):
        return f"list of: {values_of(parts[0])}"
    if origin is np.ndarray:
        return "per joint"
    if origin is dict or hint is dict:
        return "mapping"
    return PLAIN.get(hint, "section")


def _limits(metadata: Any) -> str:
    """Return the range that one entry of `Annotated` adds, also for the numbers of all joints."""
    inner = getattr(metadata, "metadata", [metadata])
    function = getattr(metadata, "func", None)
    ranges = [
        f", {sign} {limit:g}"
        for each in inner
        for name, sign in BOUNDS.items()
        if (limit := getattr(each, name, None)) is not None and abs(limit) < 1e12
    ]
    return "".join(ranges) + PER_JOINT.get(getattr(function, "__name__", ""), "")


def sections_in(hint: Any) -> Iterator[type]:
    """The sections that a type is made of."""
    if isinstance(hint, Sections):  # in `Annotated`: classes from a table of the product
        yield from hint.find(())
    elif inspect.isclass(hint) and (issubclass(hint, BaseModel) or hasattr(hint, "_fields")):
        yield hint
    for part in get_args(hint):
        yield from sections_in(part)


def scenario() -> str:
    """Every key of a scenario, a table for each section."""
    import deploy.scenario.checking.checks  # noqa: F401  (creates all registries)
    from deploy.scenario.definition import ScenarioConfiguration

    return "\n".join(_section(ScenarioConfiguration, "", {}, {}))


def _section(
    section: type, path: str, seen: dict[type, str], siblings: dict[tuple[str, ...], str]
) -> Iterator[str]:
    """Lines of a section and of those in it.

    Args:
        section: the section.
        path: its place.
        seen: the place of each section so far; gets those in this one.
        siblings: the place of each row of sections beside this one; gets those of this one.
    """
    seen[section] = path
    rows, inner = _rows(section, path, seen)
    links = [f"[{row[0]}]{row[1].partition(']')[2]}" for row in rows if _is_link_alone(row, path)]
    rows = [row for row in rows if not _is_link_alone(row, path)]
    own, repeated = _own_and_repeated(rows, path, siblings)
    yield f"## {path or 'The file itself'}\n"
    about = inspect.cleandoc(section.__doc__ or "").partition("Attributes:")[0].rstrip()
    if about and "(" not in about.partition("\n")[0].partition(" ")[0]:  # not NamedTuple's own
        yield about.replace("``", "`") + "\n"
    if own:
        yield table(["key", "values", "default", "effect"], own) + "\n"
    for place, names in repeated.items():
        yield f"As in [`{_kind(place)}`](#{_anchor(place)}): {', '.join(names)}.\n"
    if links:
        yield f"Sections: {', '.join(links)}.\n"
    beside: dict[tuple[str, ...], str] = {}
    for each, place in inner:
        yield from _section(each, place, seen, beside)


def _rows(
    section: type, path: str, seen: dict[type, str]
) -> tuple[list[list[str]], list[tuple[type, str]]]:
    """Return a row for each key of a section, and the sections in it that are new, with places."""
    hints = get_type_hints(section, include_extras=True)
    hints = {name: hints[name] for name in getattr(section, "model_fields", hints)}
    if path.endswith(")"):
        del hints["kind"]  # the heading says it
    words, rows, inner = meanings()["keys"] | attributes_of(section), [], []
    for name, hint in hints.items():
        field = getattr(section, "model_fields", {}).get(name)
        key = getattr(field, "alias", None) or name
        found = dict.fromkeys(sections_in(hint))
        places = [seen.get(each) or _place(each, f"{path}.{key}".strip(".")) for each in found]
        inner += [(e, place) for e, place in zip(found, places, strict=True) if e not in seen]
        seen |= dict(zip(found, places, strict=True))
        links = ", ".join(f"[`{_kind(p)}`](#{_anchor(p)})" for p in dict.fromkeys(places))
        kinds = [values_of(hint), unit_of(key)] if not links else [links]
        if name not in words and not links:
            raise ValueError(
                f"{section.__name__}.{name}: neither docstring nor meanings.yaml has it"
            )
        meaning = words[name] if not links else attributes_of(section).get(name, "")
        rows.append([f"`{key}`", ", ".join(filter(None, kinds)), _default(section, name), meaning])
    return rows, inner


def _is_link_alone(row: list[str], path: str) -> bool:
    """Whether a row says no more than that its key is the section of this name."""
    key = f"{path}.{row[0].strip('`')}".strip(".")
    return row[1:] == [f"[`{_kind(key)}`](#{_anchor(key)})", "", ""]


def _own_and_repeated(
    rows: list[list[str]], path: str, siblings: dict[tuple[str, ...], str]
) -> tuple[list[list[str]], dict[str, list[str]]]:
    """Return the rows to show, and by section beside this one the keys that it shows alike.

    A single repeated row is shown again: a link to it would be as long.
    """
    repeated: dict[str, list[str]] = {}
    for row in rows:
        if place := siblings.get(tuple(row)):
            repeated.setdefault(place, []).append(row[0])
    repeated = {place: names for place, names in repeated.items() if len(names) > 1}
    own = [row for row in rows if siblings.get(tuple(row)) not in repeated]
    siblings |= {tuple(row): path for row in rows if tuple(row) not in siblings}
    return own, repeated


def _place(section: type, key: str) -> str:
    """Return the place of a section: its key, with its kind where there are several."""
    kind = get_args(get_type_hints(section, include_extras=True).get("kind"))
    return f"{key} ({kind[0]})" if len(kind) == 1 else key


def _kind(place: str) -> str:
    """Return the name of a section in links: its kind, if it has one."""
    return re.sub(r"[^(]*\((\w+)\)$", r"\1", place)


def _anchor(heading: str) -> str:
    """Return the anchor that GitHub and the site give a heading."""
    return re.sub(r"[^\w -]", "", heading).lower().replace(" ", "-")


def _default(section: type, name: str) -> str:
    fields = getattr(section, "model_fields", None)
    if fields is None:
        defaults = section._field_defaults  # type: ignore[attr-defined]  # of a NamedTuple
        default = defaults.get(name, "needed")
    elif fields[name].is_required():
        default = "needed"
    else:
        default = fields[name].get_default(call_default_factory=True)
    if isinstance(default, np.ndarray):
        default = default.tolist() if default.size > 1 else f"{default.item():g}"
    if isinstance(default, BaseModel | dict | tuple) or default is None:
        return ""
    return "needed" if default == "needed" else f"`{str(default).lower()}`"
