"""The Python client of the documentation, which answers every so many-th state only.

python chunk_client.py rows|each: torques for all ticks until its next answer in one command, or the
same torques one by one. Row r has r/4 N m more than the first.
"""

from __future__ import annotations

import os
import runpy
import sys
from pathlib import Path
from typing import Any

import numpy as np
import zenoh

from bus_schema.messages.types import JOINT_STATE, TYPESTORE

CLIENT = Path(__file__).resolve().parents[2] / "bus_schema" / "clients" / "controller.py"
ROWS, PERIOD_NS = 4, round(1e9 / float(os.environ["FUNNEL_HIL_RATE_HZ"]))
IN_ROWS = sys.argv[1] == "rows"


class Publisher:
    """A publisher of commands."""

    def __init__(self, publisher: Any) -> None:
        self._publisher, self._first = publisher, np.zeros(3)

    def put(self, payload: bytes, attachment: bytes) -> None:
        command = TYPESTORE.deserialize_cdr(payload, JOINT_STATE)
        stamp = command.header.stamp
        row = (stamp.sec * 1_000_000_000 + stamp.nanosec) // PERIOD_NS % ROWS
        if row == 0:
            self._first = command.effort
        elif IN_ROWS:
            return
        rows = range(ROWS) if IN_ROWS else [row]
        command.effort = np.concatenate([self._first + 0.25 * each for each in rows])
        message = bytes(TYPESTORE.serialize_cdr(command, JOINT_STATE))
        self._publisher.put(message, attachment=attachment)


def declare_publisher(session: zenoh.Session, key: str, **options: Any) -> Publisher:
    return Publisher(declare(session, key, **options))


declare = zenoh.Session.declare_publisher
zenoh.Session.declare_publisher = declare_publisher  # type: ignore[method-assign, assignment]
del sys.argv[1:]
runpy.run_path(str(CLIENT))
