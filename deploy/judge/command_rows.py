"""The commands of a controller that answers for several ticks at once, tick by tick."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from bus_schema.errors import InvalidMessageError
from bus_schema.messages.layout import MessageLayout, Record
from bus_schema.messages.types import with_stamp


def tabulate_by_tick(
    layout: MessageLayout, payloads: Sequence[bytes], period_ns: int, end_ns: int
) -> NDArray[np.void]:
    """Return the row of the newest command at each tick, and its last row where it has no more.

    Args:
        layout: of commands.
        payloads: the commands. Those that do not answer a newer state than the one before, or one
            at the end, are left out, as the plant refuses them.
        period_ns: length of a tick.
        end_ns: end of the run, whose state is not answered.
    """
    ticks = _by_tick(_valid(layout, payloads, end_ns), period_ns, end_ns)
    return np.frombuffer(b"".join(ticks), layout.dtype)


def _valid(
    layout: MessageLayout, payloads: Sequence[bytes], end_ns: int
) -> Iterator[tuple[int, list[bytes]]]:
    """Yield the stamp of each valid command, ns, with one message for each of its rows."""
    record, newest_ns = Record(layout), -1
    for payload in payloads:
        try:
            stamp_ns = layout.decode(payload, record)
        except InvalidMessageError:
            continue
        if newest_ns < stamp_ns < end_ns:
            newest_ns = stamp_ns
            later = () if record.later is None else record.later
            yield stamp_ns, [record.payload(), *(row.tobytes() for row in later)]


def _by_tick(
    commands: Iterator[tuple[int, list[bytes]]], period_ns: int, end_ns: int
) -> Iterator[bytes]:
    for (stamp_ns, rows), (following_ns, _) in pairwise([*commands, (end_ns, [])]):
        for index, at_ns in enumerate(range(stamp_ns, following_ns, period_ns)):
            yield with_stamp(rows[min(index, len(rows) - 1)], at_ns)
