"""Reads a command and its response from two topics of a recording."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from bus_schema.arrays import Vector
from bus_schema.errors import InputError, did_you_mean
from deploy.measure.recordings import Recording

_PART = re.compile(r"(\w+)|\[([^\[\]]+)\]")


def read_series(
    file: Path, command: str, response: str, *, is_held: bool
) -> tuple[Vector, Vector, Vector]:
    """Times in s, commands and responses, by when messages were logged.

    There is a row for each message of either topic, from the first command to the last; a row
    without a response has NaN.

    Args:
        file: with messages in CDR and their definitions.
        command: topic and field, as ``/joint_commands.effort[2]``.
        response: in the same form; an element may have a joint's name, as ``position[elbow]``.
        is_held: whether a command stays until the next, or is on a line to it.
    """
    (command_ns, commands), (response_ns, responses) = (
        _read_field(file, name) for name in (command, response)
    )
    times_ns = np.union1d(command_ns, response_ns)
    rows = np.full(len(times_ns), np.nan)
    rows[np.searchsorted(times_ns, response_ns)] = responses
    inside = (times_ns >= command_ns[0]) & (times_ns <= command_ns[-1])
    times_ns, rows = times_ns[inside], rows[inside]
    held = commands[np.searchsorted(command_ns, times_ns, side="right") - 1]
    times_s = (times_ns - times_ns[0]) / 1e9
    if is_held:
        return times_s, held, rows
    return times_s, np.interp(times_s, (command_ns - times_ns[0]) / 1e9, commands), rows


def _read_field(file: Path, name: str) -> tuple[Vector, Vector]:
    """Log times in ns and values of a field, as ``/joint_states.position[2]``."""
    topic, _, field = name.partition(".")
    recording, found = Recording(file), list[tuple[int, float]]()
    for message in recording.messages(topic):
        try:
            found.append((message.logged_ns, float(_value_in(message.content, field))))
        except Exception as error:  # rosbags raises many kinds of errors
            raise InputError(f"{file}: {name}: cannot be read as a number: {error}") from error
    if not found:
        topics = sorted(recording.topics)
        hint = did_you_mean(topic, topics)
        raise InputError(f"{file}: no messages on {topic}; topics are {', '.join(topics)}{hint}")
    times_ns, values = zip(*sorted(found, key=lambda each: each[0]), strict=True)
    if not np.isfinite(values).all():
        raise InputError(f"{file}: {name}: must be one finite number in each message")
    return np.array(times_ns), np.array(values)


def _value_in(content: Any, field: str) -> Any:
    """Return a field of a message, as ``position[2]``."""
    names: Any = getattr(content, "name", None) or getattr(content, "joint_names", ())
    for word, index in _PART.findall(field):
        content = content[element_place(index, names)] if index else getattr(content, word)
    return content


def element_place(element: str, names: Sequence[str]) -> int:
    """Return the place of an element that is given by its number or by its name.

    Raises:
        ValueError: there is no such name.
    """
    if element.isdecimal():
        return int(element)
    if element not in names:
        raise ValueError(f"no element {element!r}; there are {', '.join(names) or 'no names'}")
    return names.index(element)
