"""Ticks as they come in bundles, written at once to the same bytes as message by message."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from bus_schema.messages.topics import JOINT_STATES
from bus_schema.recording.mcap_log import McapLog
from bus_schema.zenoh.bundled_ticks import Ticks
from deploy.processes.logged_view import LoggedView


def write_ticks(ticks: Ticks, sent_ns: NDArray[np.int64], log: McapLog, view: LoggedView) -> bool:
    """Write all messages of ticks, and behind each joint state that is to be shown its picture.

    Args:
        ticks: as they came.
        sent_ns: publish time of each message, shape (ticks, topics).
        log: the recording.
        view: what is shown of it.

    Returns:
        Whether that is done; what the log cannot take at once yet is to be written one by one.
    """
    packed = log.packed(ticks.topics, ticks.sequences, ticks.stamps_ns, sent_ns, ticks.payloads)
    if packed is None:
        return False
    written = 0
    if JOINT_STATES in ticks.topics:
        place, count = ticks.topics.index(JOINT_STATES), len(ticks.topics)
        stamps_ns, tick = ticks.stamps_ns[:, place].tolist(), 0
        while (due := view.next_due(stamps_ns, tick)) is not None:
            up_to = due * count + place + 1
            log.write_packed(packed, written, up_to)
            state = ticks.payloads[place][due].tobytes()
            view.show(state, stamps_ns[due], int(sent_ns[due, place]))
            written, tick = up_to, due + 1
    log.write_packed(packed, written, len(ticks))
    return True
