"""Which drives are on a bus: they are asked what moves nothing, and nothing is changed."""

from __future__ import annotations

import time
from collections import defaultdict
from collections.abc import Iterable

from bus_schema.can.frame import CanBus
from bus_schema.can.master import DriveError
from bus_schema.can.protocol import DriveProtocol
from bus_schema.link.can_configuration import CanConfiguration

FORMAT = "CAN FD"
"""Name of an answer that comes with each: 1 if the drive sent it in a CAN FD frame, else 0."""

_QUIET_S = 0.1
_FROM_A_FLOOD = 10_000


def ask_drives(
    bus: CanBus, protocol: DriveProtocol, can: CanConfiguration, node_ids: Iterable[int]
) -> dict[int, dict[str, float]]:
    """What the drives answer that are there, by address: values by their names.

    One question is asked at a time, until nothing has come for a tenth of a second.
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
    """Make sure that no drive answers but those that are known.

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
