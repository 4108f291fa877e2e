"""Run events: what happened, to whom, in one sentence."""

from __future__ import annotations

import json
from dataclasses import dataclass
from enum import StrEnum
from typing import Any

from bus_schema.messages.header import join_stamp, split_stamp
from bus_schema.messages.layout import parse
from bus_schema.messages.types import RUN_EVENT, TYPESTORE

COMMANDS_RECEIVED = "commands_received"
"""In `COUNTS` of the plant: how many commands it took off the bus and looked at."""


class EventKind(StrEnum):
    """Kinds of run events. `COUNTS` and `ENDED` carry JSON, the others a sentence.

    `INJECTED` tells of a scheduled fault that begins or ends, `FAULT` of what went wrong.
    `ENDED` is the last message of a process.
    """

    STARTED = "started"
    MODE = "mode"
    COMMANDER = "commander"
    LIMIT = "limit"
    FAULT = "fault"
    INJECTED = "injected"
    STOPPED = "stopped"
    COUNTS = "counts"
    ENDED = "ended"


@dataclass(frozen=True)
class RunEvent:
    """One event.

    Attributes:
        stamp_ns: time on the run's clock.
        source: role of the process that says it.
        kind: an `EventKind`, or a foreign kind.
        detail: a sentence, or JSON.
    """

    stamp_ns: int
    source: str
    kind: str
    detail: str

    def encode(self) -> bytes:
        """CDR bytes."""
        types = TYPESTORE.types
        sec, nanosec = split_stamp(self.stamp_ns)
        header = types["std_msgs/msg/Header"](
            types["builtin_interfaces/msg/Time"](sec, nanosec), ""
        )
        message = types[RUN_EVENT](header, self.source, self.kind, self.detail)
        return bytes(TYPESTORE.serialize_cdr(message, RUN_EVENT))

    @staticmethod
    def decode(payload: bytes) -> RunEvent:
        """Parse CDR bytes.

        Raises:
            InvalidMessageError: they are no run event.
        """
        message = parse(payload, RUN_EVENT)
        stamp = message.header.stamp
        return RunEvent(
            join_stamp(stamp.sec, stamp.nanosec), message.source, message.kind, message.detail
        )

    def values(self) -> dict[str, Any]:
        """The JSON object in `detail`; empty where there is none."""
        try:
            parsed = json.loads(self.detail)
        except (ValueError, RecursionError):  # its sender may be anybody
            return {}
        return parsed if isinstance(parsed, dict) else {}
