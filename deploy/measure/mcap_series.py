"""Reads a command and its response from two topics of a recording."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from bus_schema.arrays import Vector
from bus_schema.errors import InputError, did_you_mean
from deploy.measure.recordings import RecordedMessage, opened

_PART = re.compile(r"(\w+)|\[([^\[\]]+)\]")


@dataclass(frozen=True)
class Field:
    """One number of the messages on a topic.

    Attributes:
        topic: its name.
        element: name of the joint, or place, whose number it is; empty for no element.
        times_ns: log times of the messages that have it, shape (messages,).
        values: the numbers, same shape.
        orders: how many of these messages have which joints in which order.
        skipped: messages without this joint.
    """

    topic: str
    element: str
    times_ns: Vector
    values: Vector
    orders: Mapping[tuple[str, ...], int]
    skipped: int

    @property
    def notes(self) -> list[str]:
        """A sentence if messages were skipped."""
        if not self.skipped:
            return []
        of = self.skipped + len(self.values)
        return [f"skipped {self.skipped:,} of {of:,} messages on {self.topic}: no {self.element}"]

    @property
    def doubts(self) -> list[str]:
        """A sentence if messages differ as those of several publishers do."""
        if len(self.orders) < 2:
            return []
        listed = "; ".join(f"{', '.join(each)} ({n:,})" for each, n in self.orders.items())
        return [
            f"messages on {self.topic} name joints in {len(self.orders)} ways, as of"
            f" {len(self.orders)} publishers: {listed}"
        ]


def rows_of(command: Field, response: Field, *, is_held: bool) -> tuple[Vector, Vector, Vector]:
    """Times in s, commands and responses, by when messages were logged.

    There is a row for each message of either topic, from the first command to the last; a row
    without a response has NaN.

    Args:
        command: what was commanded.
        response: what happened.
        is_held: whether a command stays until the next, or is on a line to it.
    """
    times_ns = np.union1d(command.times_ns, response.times_ns)
    rows = np.full(len(times_ns), np.nan)
    rows[np.searchsorted(times_ns, response.times_ns)] = response.values
    inside = (times_ns >= command.times_ns[0]) & (times_ns <= command.times_ns[-1])
    times_ns, rows = times_ns[inside], rows[inside]
    held = command.values[np.searchsorted(command.times_ns, times_ns, side="right") - 1]
    times_s = (times_ns - times_ns[0]) / 1e9
    if is_held:
        return times_s, held, rows
    return times_s, np.interp(times_s, (command.times_ns - times_ns[0]) / 1e9, command.values), rows


def read_fields(file: Path, first: str, second: str) -> tuple[Field, Field]:
    """Read two numbers, each of the messages on a topic, in one pass over the recording.

    Messages that name joints, but not this one, are skipped: another device sends them. A place in
    messages that name joints means the joint at this place in most of them.

    Args:
        file: with messages in CDR and their definitions.
        first: topic and field, as ``/joint_commands.effort[2]`` or ``/states.position[elbow]``.
        second: likewise.

    Raises:
        InputError: the file cannot be read, or a message has no such number.
    """
    fields = [_FieldReader(first), _FieldReader(second)]
    with opened(file) as recording:
        for message in recording.messages(*(each.topic for each in fields)):
            for each in fields:
                if message.topic == each.topic:
                    each.take(file, message)
        for each in fields:
            if not each.found:
                topics = sorted(recording.topics)
                known = f"topics are {', '.join(topics)}{did_you_mean(each.topic, topics)}"
                raise InputError(f"{file}: no messages on {each.topic}; {known}")
        one, other = (each.field(file) for each in fields)
    return one, other


class _FieldReader:
    """Collects one number from messages.

    Args:
        name: topic and field.
    """

    def __init__(self, name: str) -> None:
        self._name = name
        self.topic, _, field = name.partition(".")
        *self._parts, self._last = [*_PART.findall(field)] or [("", "")]
        self.found: list[tuple[int, tuple[str, ...], Any]] = []

    def take(self, file: Path, message: RecordedMessage) -> None:
        """Take the value of one message, of which the last part of the name selects the number."""
        try:
            names, value = _joints(message.content), message.content
            for part in self._parts:
                value = _part(value, part, names)
        except MemoryError:
            raise
        except Exception as error:  # rosbags raises many kinds of errors
            raise self._refusal(file, error) from error
        self.found.append((message.logged_ns, names, value))

    def field(self, file: Path) -> Field:
        """Return what was collected, by time."""
        try:
            found = sorted(self.found, key=lambda each: each[0])
            return _field(self.topic, self._last, found)
        except (ValueError, TypeError, IndexError) as error:
            raise self._refusal(file, error) from error

    def _refusal(self, file: Path, error: Exception) -> InputError:
        return InputError(f"{file}: {self._name}: cannot be read as a number: {error}")


def _field(
    topic: str, last: tuple[str, str], found: Sequence[tuple[int, tuple[str, ...], Any]]
) -> Field:
    """Return the number that the last part of a name has in each message.

    Raises:
        ValueError: no message has it, or it is not finite.
    """
    orders = Counter(names for _, names, _ in found)
    usual = orders.most_common(1)[0][0]
    word, index = last
    if index.isdecimal() and int(index) < len(usual):
        index = usual[int(index)]
    numbers = [_number(value, (word, index), names) for _, names, value in found]
    has_it = np.array([number is not None for number in numbers])
    if not has_it.any() and index in usual:
        raise ValueError("the messages name joints, but have no such values")
    if not has_it.any():
        raise ValueError(f"no element {index!r}; there are {', '.join(usual) or 'no names'}")
    values = np.array(numbers, dtype=float)[has_it]
    if not np.isfinite(values).all():
        raise ValueError("must be one finite number in each message")
    times_ns = np.array([logged_ns for logged_ns, _, _ in found])[has_it]
    orders = Counter(names for (_, names, _), has in zip(found, has_it, strict=True) if has)
    return Field(topic, index, times_ns, values, orders, len(found) - len(values))


def _number(value: Any, part: tuple[str, str], names: Sequence[str]) -> float | None:
    """Return the number in a message; None if it names other joints, or has no values."""
    index = part[1]
    is_elsewhere = bool(index) and not index.isdecimal() and index not in names
    if is_elsewhere or (index and element_place(index, names) >= len(value)):
        return None
    return float(_part(value, part, names))


def _joints(content: Any) -> tuple[str, ...]:
    """Return the names of joints in a message; () if it has none."""
    names: Any = getattr(content, "name", None) or getattr(content, "joint_names", ())
    return () if isinstance(names, str) else tuple(names)


def _part(value: Any, part: tuple[str, str], names: Sequence[str]) -> Any:
    """Return an attribute, or an element by its place or name."""
    word, index = part
    return value[element_place(index, names)] if index else getattr(value, word)


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
