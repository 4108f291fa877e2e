"""Reads a command and its response from two topics of an MCAP file."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np

from bus_schema.arrays import Vector
from bus_schema.errors import InputError, did_you_mean

_PART = re.compile(r"(\w+)|\[(\d+)\]")


def read_series(
    file: Path, command: str, response: str, *, is_held: bool
) -> tuple[Vector, Vector, Vector]:
    """Times in s, commands and responses, by when messages were logged.

    There is a row for each message of either topic, from the first command to the last; a row
    without a response has NaN.

    Args:
        file: with messages in CDR and their definitions.
        command: topic and field, as ``/joint_commands.effort[2]``.
        response: in the same form.
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
    from mcap.reader import make_reader  # needed by few commands
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    topic, _, field = name.partition(".")
    types, known, found = get_typestore(Stores.EMPTY), set(), list[tuple[int, float]]()
    try:
        with file.open("rb") as stream:
            for schema, channel, message in make_reader(stream).iter_messages():
                known.add(channel.topic)
                if channel.topic != topic or schema is None:
                    continue
                if not found:
                    types.register(get_types_from_msg(schema.data.decode(), schema.name))
                value: Any = types.deserialize_cdr(message.data, schema.name)
                for word, index in _PART.findall(field):
                    value = value[int(index)] if index else getattr(value, word)
                found.append((message.log_time, float(value)))
    except Exception as error:  # mcap and rosbags raise many kinds of errors
        raise InputError(f"{file}: {name}: cannot be read as a number: {error}") from error
    if not found:
        topics, hint = ", ".join(sorted(known)), did_you_mean(topic, sorted(known))
        raise InputError(f"{file}: no messages on {topic}; topics are {topics}{hint}")
    times_ns, values = zip(*found, strict=True)
    if not np.isfinite(values).all():
        raise InputError(f"{file}: {name}: must be one finite number in each message")
    return np.array(times_ns), np.array(values)
