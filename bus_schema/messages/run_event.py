"""Run events: what happened to which process, in one sentence."""

from __future__ import annotations

import json
from dataclasses import dataclass
from enum import StrEnum
from typing import Any

from bus_schema.messages.layout import parse
from bus_schema.messages.types import RUN_EVENT, TYPESTORE, join_stamp, split_stamp

COMMANDS_RECEIVED = "commands_received"
"""Key in the plant's `COUNTS`: how many commands it took off the bus and checked."""


class EventKind(StrEnum):
    """Kinds of run events. `COUNTS`, `ENDED` and `ANSWER` carry JSON, the others a sentence.

    `INJECTED` reports that a scheduled fault begins or ends, `FAULT` what went wrong. `ENDED` is
    the last message of a process. `ANSWER` is a chunk of actions from a policy server.
    """

    STARTED = "started"
    MODE = "mode"
    COMMANDER = "commander"
    LIMIT = "limit"
    FAULT = "fault"
    INJECTED = "injected"
    STOPPED = "stopped"
    ANSWER = "answer"
    COUNTS = "counts"
    ENDED = "ended"


@dataclass(frozen=True)
class RunEvent:
    """One event.

    Attributes:
        stamp_ns: time on the run's clock.
        source: role of the process that sends it.
        kind: an `EventKind`, or a foreign kind.
        detail: a sentence, or JSON.
    """

    stamp_ns: int
    source: str
    kind: str
    detail: str

    def encode(self) -> bytes:
        """Return the CDR bytes."""
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
            InvalidMessageError: the bytes are no run event.
        """
        message = parse(payload, RUN_EVENT)
        stamp = message.header.stamp
        return RunEvent(
            join_stamp(stamp.sec, stamp.nanosec), message.source, message.kind, message.detail
        )

    def values(self) -> dict[str, Any]:
        """JSON object in `detail`; empty if there is none."""
        try:
            parsed = json.loads(self.detail)
        except (ValueError, RecursionError):  # any peer may have sent it
            return {}
        return parsed if isinstance(parsed, dict) else {}
