"""Record of a fault: the last joint states and commands before it, to find its cause."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from bus_schema.messages import topics
from bus_schema.messages.run_event import EventKind
from bus_schema.messages.topics import Topic
from bus_schema.messages.types import stamps_ns
from bus_schema.recording.atomic_files import write_json
from deploy.judge.run_data import RunData

KEPT = 100
"""Number of states and commands in a record."""

_FIELDS = {
    topics.JOINT_STATES: ("position", "velocity", "effort"),
    topics.JOINT_COMMANDS: ("effort",),
}


def write_fault_record(run: RunData, file: Path) -> None:
    """Write the record of a run's first fault; nothing without a fault.

    It contains only messages that the recorder received.
    """
    faults = [event for event in run.events if event.kind == EventKind.FAULT]
    if not faults:
        return
    first = min(faults, key=lambda event: event.stamp_ns)
    record = {
        "source": first.source,
        "at_s": first.stamp_ns * 1e-9,
        "detail": first.detail,
        "modes": [
            {"source": event.source, "at_s": event.stamp_ns * 1e-9, "mode": event.detail}
            for event in run.events
            if event.kind == EventKind.MODE
        ],
        "joint_names": list(run.setup.robot.joint_names),
        "states": _last(run, topics.JOINT_STATES, first.stamp_ns),
        "commands": _last(run, topics.JOINT_COMMANDS, first.stamp_ns),
    }
    write_json(file, record)


def _last(run: RunData, topic: Topic, until_ns: int) -> list[dict[str, Any]]:
    """Return the last messages with stamps up to an instant, in the order of sending."""
    table = run.tables[topic.name]
    sent_ns = stamps_ns(table)
    rows = np.flatnonzero(sent_ns <= until_ns)[-KEPT:]
    return [
        {"stamp_s": float(sent_ns[row] * 1e-9)}
        | {name: table[name][row].tolist() for name in _FIELDS[topic]}
        for row in rows
    ]
