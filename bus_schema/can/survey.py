"""Finds the drives on a bus by requests that change nothing."""

from __future__ import annotations

import time
from collections import defaultdict
from collections.abc import Iterable

from bus_schema.can.frame import CanBus
from bus_schema.can.master import DriveError
from bus_schema.can.protocol import DriveProtocol
from bus_schema.link.can_configuration import CanConfiguration

FORMAT = "CAN FD"
"""Name of a value beside each answer: 1 if it came in a CAN FD frame, else 0."""

_QUIET_S = 0.1
_FROM_A_FLOOD = 10_000


def ask_drives(
    bus: CanBus, protocol: DriveProtocol, can: CanConfiguration, node_ids: Iterable[int]
) -> dict[int, dict[str, float]]:
    """Return the answers of all drives by address: values by name.

    It sends one question at a time, and waits until no answer came for a tenth of a second.
    """
    found: dict[int, dict[str, float]] = defaultdict(dict)
    asked = [protocol.questions(can, node_id) for node_id in node_ids]
    for frames in zip(*asked, strict=True):
        bus.send_all(frames)
        quiet_from_s = time.monotonic() + _QUIET_S
        for _ in range(_FROM_A_FLOOD):
            frame = bus.receive(max(0.0, quiet_from_s - time.monotonic()))
            if frame is None:
                break
            answer = protocol.answer(frame)
            if answer is not None:
                node_id, name, value = answer
                found[node_id] |= {name: value, FORMAT: float(frame.is_fd)}
                quiet_from_s = time.monotonic() + _QUIET_S
    return dict(found)


def require_no_others(
    bus: CanBus, protocol: DriveProtocol, can: CanConfiguration, known: Iterable[int]
) -> None:
    """Check that only known drives answer.

    Raises:
        DriveError: with the addresses that answer.
    """
    others = sorted({*range(1, protocol.largest_node_id + 1)} - {*known})
    if strange := sorted(ask_drives(bus, protocol, can, others).keys() - {*known}):
        nodes = ", ".join(map(str, strange))
        raise DriveError(
            f"drives with addresses {nodes} answer on this bus but are not in the scenario, so"
            " nothing was commanded; disconnect them, or choose another bus (link.can.channel)"
        )
