"""Messages of runs that are made up, for the judge."""

from __future__ import annotations

from typing import Any

from bus_schema.messages.record import Record
from bus_schema.messages.topics import Topic, layout

JOINTS = ("base_yaw", "shoulder", "elbow")


def rows(topic: Topic, *columns: dict[str, Any]) -> list[bytes]:
    """Messages of a topic, one per column, a millisecond apart unless they say otherwise."""
    messages = []
    for index, values in enumerate(columns):
        record = Record(layout(topic, JOINTS))
        record.stamp_ns = values.get("stamp_ns", index * 1_000_000)
        for name in values.keys() - {"stamp_ns"}:
            record.fields[name][:] = values[name]
        messages.append(record.payload())
    return messages
