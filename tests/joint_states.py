"""Joint states as others encode them, with rosbags' own types."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np
from mcap.writer import Writer

from bus_schema.messages.types import JOINT_STATE, TYPESTORE, schema_text


def joint_state(
    names: Sequence[str], position: Sequence[float] = (), velocity: Sequence[float] = (),
    effort: Sequence[float] = (), *, stamp_ns: int = 0, frame: str = "world", **options: bool,
) -> bytes:  # fmt: skip
    """A message in CDR; the options are those of rosbags' encoder."""
    types = TYPESTORE.types
    time = types["builtin_interfaces/msg/Time"](*divmod(stamp_ns, 1_000_000_000))
    header = types["std_msgs/msg/Header"](time, frame)
    rows = (np.array(row, dtype=np.float64) for row in (position, velocity, effort))
    message = types[JOINT_STATE](header, list(names), *rows)
    return bytes(TYPESTORE.serialize_cdr(message, JOINT_STATE, **options))


def write_bag(file: Path, messages: Iterable[tuple[str, int, bytes]]) -> None:
    """An MCAP file of joint states: topic, log time in ns and message, in this order."""
    with file.open("wb") as stream:
        writer = Writer(stream)
        writer.start()
        schema = writer.register_schema(JOINT_STATE, "ros2msg", schema_text(JOINT_STATE).encode())
        channels: dict[str, int] = {}
        for topic, logged_ns, data in messages:
            if topic not in channels:
                channels[topic] = writer.register_channel(topic, "cdr", schema)
            writer.add_message(channels[topic], logged_ns, data, logged_ns)
        writer.finish()
