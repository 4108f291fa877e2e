"""Explanations of values that a schema rejects, so that users can correct them."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from difflib import get_close_matches
from pathlib import Path
from typing import Annotated, Any, Literal, get_args, get_origin, get_type_hints

from pydantic import BaseModel, ValidationError

from bus_schema.configuration import Sections, shown
from bus_schema.errors import did_you_mean
from bus_schema.foreign_text import shortened
from deploy.scenario.base_units import hint_of_unit, with_unit_of_key

_MOST_PROBLEMS = 20
_NUMBER = "be a valid number"
_INTEGER = "be a valid integer"
_BOOLEAN = "be a valid boolean"
_MUST: Mapping[str, str] = {
    "value_error": "be {error}",
    "literal_error": "be {expected}",
    "greater_than": "be greater than {gt:.15g}",
    "greater_than_equal": "be greater than or equal to {ge:.15g}",
    "less_than": "be less than {lt:.15g}",
    "less_than_equal": "be less than or equal to {le:.15g}",
    "finite_number": "be a finite number",
    "float_type": _NUMBER,
    "float_parsing": f"{_NUMBER}, unable to parse string as a number",
    "int_type": _INTEGER,
    "int_parsing": f"{_INTEGER}, unable to parse string as an integer",
    "int_parsing_size": f"{_INTEGER}, with fewer digits",
    "int_from_float": f"{_INTEGER}, got a number with a fractional part",
    "bool_type": _BOOLEAN,
    "bool_parsing": f"{_BOOLEAN}, unable to interpret input",
    "string_type": "be a valid string",
    "string_too_long": "have at most {max_length} characters",
    "string_pattern_mismatch": "match {pattern}",
    "too_long": "have at most {max_length} items, not {actual_length}",
    "too_short": "have {min_length} or more items, not {actual_length}",
}
"""Allowed values in words, by pydantic's type of error, with the values of its context."""
_NOT_A_MAPPING = ("model_type", "model_attributes_type", "named_tuple_type", "dict_type")
_ITEMS: dict[Any, str] = {str: "strings", int: "whole numbers", float: "numbers"}
_LONGEST_ALLOWED = 1000
_LIKELY = 0.75
"""Similarity required of names that are not in the same section."""


@dataclass(frozen=True)
class Origin:
    """Origin of values.

    Attributes:
        file: the file that contains them.
        overrides: values set in addition, as ``dotted.key=value``.
        given_by: the option that set them.
    """

    file: Path
    overrides: Sequence[str] = ()
    given_by: str = "--set"

    def of(self, key: str, beside: Sequence[str] = ()) -> str:
        """Describe the origin of a dotted key's value: the last that set it, or a part of it.

        If that is the file, the origin of the keys `beside` it is added.
        """
        own = self._set(key)
        if own is not None:
            return own
        others = [other for each in beside if (other := self._set(each)) is not None]
        return ", ".join([str(self.file), *dict.fromkeys(f"with {other}" for other in others)])

    def is_set(self, key: str) -> bool:
        """Whether it was set beside the file."""
        return self._set(key) is not None

    def _set(self, key: str) -> str | None:
        for override in reversed(self.overrides):
            given = override.partition("=")[0]
            if _is_within(key, given) or _is_within(given, key):
                return f"{self.given_by} {shortened(override)}"
        return None


def explain(
    error: ValidationError, model: type[BaseModel], origin: Origin, within: Sequence[str] = ()
) -> list[str]:
    """Explain invalid values: origin, key, value, and what is allowed; a line each.

    Args:
        error: what pydantic says.
        model: the class that it validated.
        origin: origin of the values.
        within: keys of the section whose values they are.
    """
    problems = error.errors(include_url=False)
    lines = [_sentence(each, model, origin, within) for each in problems[:_MOST_PROBLEMS]]
    more = len(problems) - len(lines)
    return [*lines, f"{origin.file}: and {more} more problems"] if more else lines


def _sentence(problem: Any, model: type[BaseModel], origin: Origin, within: Sequence[str]) -> str:
    place = problem["loc"]
    key = shortened(".".join(str(part) for part in (*within, *place)))
    path, sections = _descend(model, place[:-1])
    source = origin.of(".".join([*within, *path, *map(str, place[-1:])]))
    if problem["type"] == "extra_forbidden":
        hint = _in_other_unit(str(place[-1]), problem["input"], sections) or _did_you_mean(
            str(place[-1]), sections, model
        )
        return f"{source}: {key}: unknown key{hint}"
    if problem["type"] == "missing":
        return f"{source}: {key}: is missing"
    if problem["type"] in _NOT_A_MAPPING:
        return f"{source}: {key} = {shown(problem['input'])}: must be a mapping of keys to values"
    if problem["type"] in ("tuple_type", "list_type"):
        held = next(filter(None, (_item(_keys(s).get(str(place[-1]))) for s in sections)), "values")
        return f"{source}: {key} = {shown(problem['input'])}: must be a list of {held}"
    context = problem.get("ctx", {})
    if problem["type"] in ("union_tag_invalid", "union_tag_not_found"):
        which = context["discriminator"].strip("'")
        if "tag" not in context:
            return f"{source}: {key}.{which}: is missing"
        _, kinds = _descend(model, place)
        hint = did_you_mean(context["tag"], _literals([_keys(kind).get(which) for kind in kinds]))
        wrong, allowed = shown(context["tag"]), context["expected_tags"]
        return f"{source}: {key}.{which} = {wrong}: must be one of {allowed}{hint}"
    must = _MUST.get(problem["type"], f"be valid: {problem['msg']}")
    allowed = shortened(must.format_map(context), _LONGEST_ALLOWED)
    if problem["type"] == "literal_error":
        names = _literals([_keys(section).get(str(place[-1])) for section in sections])
        allowed += did_you_mean(str(problem["input"]), names)
    named = next((part for part in reversed(place) if isinstance(part, str)), "")
    hint = hint_of_unit(named, problem["input"])
    return f"{source}: {key} = {shown(problem['input'])}: must {allowed}{hint}"


def _in_other_unit(unknown: str, value: Any, sections: Sequence[type]) -> str:
    """Return how to write the value of a key that is a known one with another unit."""
    known = (name for section in sections for name in _keys(section))
    found = with_unit_of_key(unknown, value, known)
    return "" if found is None else f"; write {found[0]}: {found[1]}"


def _did_you_mean(unknown: str, sections: Sequence[type], model: type[BaseModel]) -> str:
    """Return a similar key: one in the same section, or else one of that name elsewhere."""
    unknown = shortened(unknown)
    beside = {name: name for section in sections for name in _keys(section)}
    elsewhere: dict[str, str] = {}
    for key in _all_keys(model):
        elsewhere.setdefault(key.rpartition(".")[2], key)
    for names, alike in ((beside, 0.6), (elsewhere, _LIKELY)):
        for found in get_close_matches(unknown, names, n=1, cutoff=alike):
            return f"; did you mean {names[found]}?"
    return ""


def _descend(model: type[BaseModel], place: Sequence[Any]) -> tuple[list[str], Sequence[type]]:
    """Return the dotted key of a place, without pydantic's additions, and the sections on the way.

    Pydantic adds the kind of a section where there are several.
    """
    sections: Sequence[type] = [model]
    path = []
    for part in place:
        inner = [s for section in sections for s in _sections(_keys(section).get(str(part)))]
        known = any(part in _keys(section) for section in sections)
        if known or isinstance(part, int):
            path.append(str(part))
        sections = inner or sections
    return path, sections


def _all_keys(section: type, prefix: str = "") -> Iterator[str]:
    """Return all dotted keys of a section, those of lists without an index."""
    for name, annotation in _keys(section).items():
        yield prefix + name
        for inner in _sections(annotation):
            yield from _all_keys(inner, f"{prefix}{name}.")


def _keys(section: type) -> dict[str, Any]:
    """Return the annotations of a section's keys, by name."""
    if issubclass(section, BaseModel):
        fields = section.model_fields.items()
        return {f.alias or name: (f.annotation, *f.metadata) for name, f in fields}
    return get_type_hints(section, include_extras=True)


def _sections(annotation: Any) -> Iterator[type]:
    """Return the sections in an annotation."""
    if isinstance(annotation, Sections):
        yield from annotation.find(None)
    elif isinstance(annotation, type) and (
        issubclass(annotation, BaseModel) or hasattr(annotation, "_fields")
    ):
        yield annotation
    else:
        parts = annotation if isinstance(annotation, tuple) else get_args(annotation)
        for part in parts:
            yield from _sections(part)


def _literals(annotation: Any) -> list[str]:
    """Return the texts that an annotation, or one of several, allows."""
    if get_origin(annotation) is Literal:
        return [value for value in get_args(annotation) if isinstance(value, str)]
    parts = annotation if isinstance(annotation, list | tuple) else get_args(annotation)
    return [text for part in parts for text in _literals(part)]


def _item(annotation: Any) -> str | None:
    """Return the element type of an annotation's lists; None if it allows no list."""
    if get_origin(annotation) in (tuple, list):
        item = get_args(annotation)[0]
        while get_origin(item) is Annotated:
            item = get_args(item)[0]
        return _ITEMS.get(item, "mappings of keys to values")
    parts = annotation if isinstance(annotation, tuple) else get_args(annotation)
    return next(filter(None, map(_item, parts)), None)


def _is_within(key: str, section: str) -> bool:
    return key == section or key.startswith(f"{section}.")
