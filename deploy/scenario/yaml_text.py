"""Conversion of YAML text to plain values, within limits on size and depth.

A YAML parser recurses for every nested list, and an alias stands for all that it refers to: a
hundred bytes can expand to gigabytes. So the events of a text, never more than its characters, are
counted before anything is built from them.
"""

from __future__ import annotations

import re
from typing import Any, NamedTuple

import yaml

from bus_schema.configuration import ConfigurationError

DEEPEST = 50
MOST_NODES = 100_000
MOST_CHARACTERS = 5_000_000
_MOST_BITS = 1000
"""Limit on whole numbers: larger ones are of no use in computations."""

_WANTED = {"int": "a whole number", "float": "a number", "timestamp": "a valid date"}
"""Required values by their form or by their tag."""

_OCTAL = re.compile(r"[-+]?0[0-7_]+")
"""In YAML 1.1, which also reads 1:30 in base 60."""

_MERGE = "tag:yaml.org,2002:merge"

# Several times as fast, where it is available.
_LOADER: Any = getattr(yaml, "CSafeLoader", yaml.SafeLoader)


class _Level(NamedTuple):
    """An open list or mapping: the count of nodes at its start, and its anchor."""

    nodes_before: int
    anchor: str | None


def problem_in(error: yaml.YAMLError) -> str:
    """Describe, as a sentence, a parser's error and its line."""
    if not isinstance(error, yaml.MarkedYAMLError) or error.problem is None:
        return str(error)
    problem = re.sub(
        r"^could not determine a constructor for the tag", "unknown tag", error.problem
    )
    problem = problem.replace("but found another document", "holds a second document after ---")
    mark = error.problem_mark or error.context_mark
    return problem if mark is None else f"line {mark.line + 1}, column {mark.column + 1}: {problem}"


def values_of(text: str) -> Any:
    """Return the values of a YAML text.

    Raises:
        ConfigurationError: a value contradicts its form or its tag, or exceeds the limits, or a key
            is given twice.
        yaml.YAMLError: the text is no YAML.
    """
    if len(text) > MOST_CHARACTERS:
        allowed = f"must have at most {MOST_CHARACTERS} characters"
        raise ConfigurationError("the text", f"{len(text)} characters", allowed)
    _check_size(text)
    loader = _LOADER(text)
    try:
        node = loader.get_single_node()
        if node is None:
            return None
        _check_values(loader, node, "", set())
        return loader.construct_document(node)
    finally:
        loader.dispose()


def _check_size(text: str) -> None:
    """Refuse text that is nested too deep, or too large once aliases are expanded."""
    levels: list[_Level] = []
    sizes: dict[str, int] = {}
    nodes, key = 0, ""
    for event in yaml.parse(text, Loader=_LOADER):
        if isinstance(event, yaml.CollectionEndEvent):
            level = levels.pop()
            if level.anchor is not None:
                sizes[level.anchor] = nodes - level.nodes_before
            continue
        if not isinstance(event, yaml.NodeEvent):
            continue
        if len(levels) == 1 and isinstance(event, yaml.ScalarEvent) and _column(event) == 0:
            key = event.value
        if isinstance(event, yaml.AliasEvent):
            if any(level.anchor == event.anchor for level in levels):
                raise ConfigurationError(key, f"*{event.anchor}", "must not contain itself")
            nodes += sizes.get(str(event.anchor), 1)
        else:
            nodes += 1
        if isinstance(event, yaml.CollectionStartEvent):
            levels.append(_Level(nodes - 1, event.anchor))
        if len(levels) > DEEPEST:
            allowed = f"must not be nested deeper than {DEEPEST} levels"
            raise ConfigurationError(key, _line(text, event), allowed)
        if nodes > MOST_NODES:
            allowed = f"must have at most {MOST_NODES} values, with aliases expanded"
            raise ConfigurationError(key, _line(text, event), allowed)


def _check_values(loader: Any, node: yaml.Node, key: str, seen: set[int]) -> None:
    """Refuse values that contradict their form or tag, and mappings with a key twice."""
    if id(node) in seen:
        return
    seen.add(id(node))
    if isinstance(node, yaml.ScalarNode):
        _require_readable(loader, node, key)
    elif isinstance(node, yaml.SequenceNode):
        for index, inner in enumerate(node.value):
            _check_values(loader, inner, _dotted(key, index), seen)
    elif isinstance(node, yaml.MappingNode):
        lines: dict[str, int] = {}
        for name, inner in node.value:
            if not isinstance(name, yaml.ScalarNode):
                _check_values(loader, name, key, seen)
                _check_values(loader, inner, key, seen)
                continue
            if name.tag != _MERGE:
                _require_readable(loader, name, key or "key")
            own, again = _dotted(key, name.value), name.start_mark.line + 1
            _check_values(loader, inner, own, seen)
            if name.value in lines:  # the parser would keep the last value
                allowed = f"must occur only once; it is in lines {lines[name.value]} and {again}"
                raise ConfigurationError(own, _said(inner), allowed)
            lines[name.value] = again


def _require_readable(loader: Any, node: yaml.ScalarNode, key: str) -> None:
    """Refuse values that PyYAML cannot build; it passes any exception of Python on."""
    try:
        value = loader.construct_object(node)
    except yaml.YAMLError:
        raise
    except Exception:  # noqa: BLE001
        is_readable = False
    else:
        is_readable = not isinstance(value, int) or value.bit_length() <= _MOST_BITS
    if not is_readable:
        tag = node.tag.rpartition(":")[2]
        allowed = f"must be {_WANTED.get(tag, f'a valid {tag}')}, or a text in quotes"
        raise ConfigurationError(key, node.value, allowed)
    is_octal = _OCTAL.fullmatch(node.value) and value != int(node.value.replace("_", ""))
    if isinstance(value, int | float) and (is_octal or ":" in node.value):
        form = "a leading 0" if is_octal else "colons"
        allowed = f"must be a number without {form}, or a text in quotes: YAML reads it as {value}"
        raise ConfigurationError(key, node.value, allowed)


def _dotted(key: str, name: object) -> str:
    return f"{key}.{name}" if key else str(name)


def _said(node: yaml.Node) -> str:
    return node.value if isinstance(node, yaml.ScalarNode) else "a section"


def _line(text: str, event: yaml.Event) -> str:
    """Return an event's line, with its number."""
    number = 0 if event.start_mark is None else event.start_mark.line
    return f"line {number + 1}, {text.splitlines()[number].strip()}"


def _column(event: yaml.Event) -> int | None:
    return None if event.start_mark is None else event.start_mark.column
