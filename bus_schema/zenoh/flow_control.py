"""How far a sender may be ahead of the recorders, where nothing that is recorded may be lost.

What finds a peer's queue full is dropped (`session.py`), so that no subscriber holds up a loop. So
recorders say how far they have come, and a sender that is too far ahead of one waits for it, well
before a queue is full. Others are not waited for.
"""

from __future__ import annotations

import logging
import math
import threading
from collections import deque

logger = logging.getLogger(__name__)

LARGEST_LEAD_BYTES = 1 << 19
"""Half of what the queue to a peer holds: 16 batches of up to 64 KiB."""
OVERHEAD_BYTES = 100
"""What else of each message is in the queue: key, attachment, headers."""
_PATIENCE_S = 60.0
_FIRST_PATIENCE_S = 15.0
"""For one that has never said how far it has come: anybody can announce one. But a true one may be
held up for seconds by a slow machine."""


class FlowControl:
    """Counts what was sent against what the slowest recorder has.

    Args:
        patience_s: how long one that says nothing is waited for before it counts no more.
    """

    def __init__(self, patience_s: float = _PATIENCE_S) -> None:
        self._patience_s = patience_s
        self._sent_bytes = self._recorded_bytes = 0
        self._marks: deque[tuple[int, int]] = deque()  # sequence, bytes sent with and before it
        self._last_mark = 0
        self._recorders: dict[str, int] = {}  # sequence that each has, by session
        self._silent: set[str] = set()  # of these, those that have said nothing yet
        self._change = threading.Condition()

    def join(self, recorder: str) -> None:
        """A recorder is there, and gets all that is sent from now on."""
        with self._change:
            if recorder not in self._recorders:
                self._recorders[recorder] = self._last_mark
                self._silent.add(recorder)

    def leave(self, recorder: str) -> None:
        """A recorder is gone, and is waited for no longer."""
        with self._change:
            self._drop(recorder)
            self._change.notify_all()

    def send(self, size_bytes: int, mark: int = 0) -> None:
        """Messages are sent; recorders will tell of them by their `mark`, should they have one."""
        with self._change:
            self._sent_bytes += size_bytes
            if mark:
                self._marks.append((mark, self._sent_bytes))
                self._last_mark = mark

    def acknowledge(self, recorder: str, mark: int) -> None:
        """A recorder has all that was sent up to a mark."""
        with self._change:
            if recorder in self._recorders:
                self._silent.discard(recorder)
                newest = min(mark, self._last_mark)
                self._recorders[recorder] = max(newest, self._recorders[recorder])
                self._change.notify_all()

    def await_recorders(self) -> None:
        """Wait until none of them is too far behind."""
        with self._change:
            patience_s = min(self._patience_s, _FIRST_PATIENCE_S if self._silent else math.inf)
            if self._change.wait_for(self._may_send, patience_s):
                return
            self._drop(min(self._silent or self._recorders, key=self._recorders.__getitem__))
        logger.warning(
            "a recorder has recorded nothing for %g s, and is waited for no longer: what it misses"
            " it counts as lost", patience_s,
        )  # fmt: skip

    def _drop(self, recorder: str) -> None:
        self._recorders.pop(recorder, None)
        self._silent.discard(recorder)

    def _may_send(self) -> bool:
        slowest = min(self._recorders.values(), default=self._last_mark)
        while self._marks and self._marks[0][0] <= slowest:
            self._recorded_bytes = self._marks.popleft()[1]
        return not self._recorders or (
            self._sent_bytes - self._recorded_bytes <= LARGEST_LEAD_BYTES
        )
