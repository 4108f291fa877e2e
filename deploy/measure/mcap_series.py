"""Reads a command and its response from two topics of an MCAP file."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from bus_schema.arrays import Vector
from bus_schema.errors import InputError, did_you_mean

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
    known, found = set[str](), list[tuple[int, float]]()
    try:
        for message in messages(file, topic):
            known.add(message.topic)
            if message.content is None:
                continue
            value: Any = message.content
            names: Any = getattr(value, "name", None) or getattr(value, "joint_names", ())
            for word, index in _PART.findall(field):
                value = value[element_place(index, names)] if index else getattr(value, word)
            found.append((message.logged_ns, float(value)))
    except Exception as error:  # mcap and rosbags raise many kinds of errors
        raise InputError(f"{file}: {name}: cannot be read as a number: {error}") from error
    if not found:
        topics, hint = ", ".join(sorted(known)), did_you_mean(topic, sorted(known))
        raise InputError(f"{file}: no messages on {topic}; topics are {topics}{hint}")
    times_ns, values = zip(*found, strict=True)
    if not np.isfinite(values).all():
        raise InputError(f"{file}: {name}: must be one finite number in each message")
    return np.array(times_ns), np.array(values)


class RecordedMessage(NamedTuple):
    """A message of a recording.

    Attributes:
        topic: its name.
        type_name: as ``sensor_msgs/msg/JointState``.
        logged_ns: time at which it was recorded.
        content: its fields; None for topics that were not asked for.
    """

    topic: str
    type_name: str
    logged_ns: int
    content: Any


def messages(file: Path, wanted: str) -> Iterator[RecordedMessage]:
    """Yield the messages of an MCAP file, of a rosbag2 ``.db3`` file or of a bag's folder.

    Args:
        file: with messages in CDR; MCAP files have their definitions.
        wanted: topic, or type of message, whose contents are read.
    """
    from mcap.reader import make_reader  # needed by few commands
    from rosbags.highlevel import AnyReader
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    if file.suffix != ".mcap":
        jazzy = get_typestore(Stores.ROS2_JAZZY)  # for bags without definitions
        with AnyReader([file], default_typestore=jazzy) as bag:
            for connection, logged_ns, data in bag.messages():
                is_wanted = wanted in (connection.topic, connection.msgtype)
                content = bag.deserialize(data, connection.msgtype) if is_wanted else None
                yield RecordedMessage(connection.topic, connection.msgtype, logged_ns, content)
        return
    types, known = get_typestore(Stores.EMPTY), set[str]()
    with file.open("rb") as stream:
        for schema, channel, message in make_reader(stream).iter_messages():
            name, content = "" if schema is None else schema.name, None
            if schema is not None and wanted in (channel.topic, name):
                if name not in known:
                    types.register(get_types_from_msg(schema.data.decode(), name))
                    known.add(name)
                content = types.deserialize_cdr(message.data, name)
            yield RecordedMessage(channel.topic, name, message.log_time, content)


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
