"""The commands of a controller that answers for several ticks at once, tick by tick."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from bus_schema.errors import InvalidMessageError
from bus_schema.messages.layout import MessageLayout
from bus_schema.messages.record import Record
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


class _Rows(NamedTuple):
    """Rows of a command as messages of one row, and the ticks from one to the next."""

    messages: NDArray[np.void]
    ticks: int

    def at(self, tick: int) -> bytes:
        """Return the message of a tick after the first row; values are linear between rows."""
        row, rest = divmod(tick, self.ticks)
        if row >= len(self.messages) - 1:
            return self.messages[-1:].tobytes()
        before, after = self.messages[row : row + 2]
        message = self.messages[row : row + 1].copy()
        for name in {"position", "velocity", "effort"} & set(message.dtype.names or ()):
            message[name] = before[name] + rest / self.ticks * (after[name] - before[name])
        return message.tobytes()


def _valid(
    layout: MessageLayout, payloads: Sequence[bytes], end_ns: int
) -> Iterator[tuple[int, _Rows]]:
    """Yield the stamp of each valid command, ns, with its rows."""
    record, newest_ns = Record(layout), -1
    for payload in payloads:
        try:
            stamp_ns = layout.decode(payload, record)
        except InvalidMessageError:
            continue
        if newest_ns < stamp_ns < end_ns:
            newest_ns = stamp_ns
            later = b"" if record.later is None else record.later.tobytes()
            messages = np.frombuffer(record.payload() + later, layout.dtype)
            yield stamp_ns, _Rows(messages, record.row_ticks)


def _by_tick(commands: Iterator[tuple[int, _Rows]], period_ns: int, end_ns: int) -> Iterator[bytes]:
    none = _Rows(np.empty(0, np.void), 1)
    for (stamp_ns, rows), (following_ns, _) in pairwise([*commands, (end_ns, none)]):
        for index, at_ns in enumerate(range(stamp_ns, following_ns, period_ns)):
            yield with_stamp(rows.at(index), at_ns)
