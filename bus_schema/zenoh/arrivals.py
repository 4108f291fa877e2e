"""Commands that arrived at the plant, kept until its loop takes them."""

from __future__ import annotations

import queue
import threading
import time
from collections.abc import Callable

from bus_schema.link.interface import CommandArrival
from bus_schema.messages.layout import MAX_PAYLOAD_BYTES
from bus_schema.runtime.clock import Clock
from bus_schema.zenoh.ros_graph import Attachment
from bus_schema.zenoh.session import Delivery, Inbox

LARGEST_BACKLOG = 10_000
_LOOK_S = 0.05
_CLOSING_LOOK_S = 0.01
Note = Callable[[bytes], None]
_NO_ATTACHMENT = Attachment(sequence=0, source_time_ns=0, gid=b"")


class Arrivals:
    """Queue of commands, filled by a thread that stamps each on arrival, even if the loop is busy.

    Args:
        inbox: source of the commands; no other thread waits on it.
        clock: the plant's clock, which stamps them.
        note: called with the sender of each command.

    Attributes:
        overflow: how many were dropped because too many waited to be taken.
    """

    def __init__(self, inbox: Inbox, clock: Clock, note: Note) -> None:
        self._inbox, self._clock, self._note = inbox, clock, note
        self._kept: queue.SimpleQueue[CommandArrival] = queue.SimpleQueue()
        self._first: list[CommandArrival] = []
        self._closed = threading.Event()
        self.overflow = 0
        self._thread = threading.Thread(target=self._receive, daemon=True)
        self._thread.start()

    def is_empty(self) -> bool:
        """Whether no command waits to be taken."""
        return not self._first and self._kept.empty()

    def await_one(self, timeout_s: float) -> bool:
        """Wait for a command that is not yet taken; return whether there is one."""
        if not self._first:
            try:
                self._first.append(self._kept.get(timeout=timeout_s))
            except queue.Empty:
                return False
        return True

    def take(self) -> list[CommandArrival]:
        """Return all commands that arrived since the last call, in order."""
        taken, self._first = self._first, []
        taken.extend(self._kept.get_nowait() for _ in range(self._kept.qsize()))
        return taken

    def close(self) -> None:
        """End the thread: if it leaves Zenoh while Python exits, the process aborts."""
        self._closed.set()
        self._inbox.knock()
        self._thread.join()
        self._inbox.close()

    def _receive(self) -> None:
        while True:  # a sender that knocks at a full inbox waits until there is room
            delivery = self._inbox.wait()
            if delivery is not None:
                self._admit(delivery)
            elif self._closed.is_set():
                return

    def _admit(self, delivery: Delivery) -> None:
        if self._kept.qsize() >= LARGEST_BACKLOG:
            self.overflow += 1  # a flood: later commands are of no use, and memory is bounded
            return
        arrival = arrival_of(delivery.payload, delivery.attachment, self._clock.now_ns())
        self._note(arrival.sender)
        self._kept.put(arrival)


class AwaitedArrivals(Arrivals):
    """In virtual time the loop itself waits for commands, which saves a switch of threads.

    The thread then only ends these waits, and empties the inbox while the loop does not wait: a
    full inbox would block all other messages from the network.
    """

    def __init__(self, inbox: Inbox, clock: Clock, note: Note) -> None:
        self._is_taking = threading.Lock()
        super().__init__(inbox, clock, note)

    def close(self) -> None:
        self._closed.set()
        while self._thread.is_alive():  # it may be blocked by a full inbox
            with self._is_taking:
                self._admit_all()
            self._thread.join(_CLOSING_LOOK_S)
        self._inbox.close()

    def is_empty(self) -> bool:
        with self._is_taking:
            self._admit_all()
        return super().is_empty()

    def await_one(self, timeout_s: float) -> bool:
        give_up_s = time.monotonic() + timeout_s
        with self._is_taking:
            self._admit_all()
            while super().is_empty() and time.monotonic() < give_up_s:
                delivery = self._inbox.wait()
                if delivery is not None:
                    self._admit(delivery)
        return not super().is_empty()

    def take(self) -> list[CommandArrival]:
        with self._is_taking:
            self._admit_all()
        return super().take()

    def _receive(self) -> None:
        while not self._closed.wait(_LOOK_S):
            if self._is_taking.acquire(blocking=False):
                self._admit_all()
                self._is_taking.release()
            else:
                self._inbox.knock()

    def _admit_all(self) -> None:
        for _ in range(LARGEST_BACKLOG):  # a flood may never end
            delivery = self._inbox.take()
            if delivery is None:
                return
            self._admit(delivery)


def arrival_of(payload: bytes, attachment: bytes, now_ns: int) -> CommandArrival:
    """Return a command for the plant's loop; a sender without an attachment has no name."""
    known = Attachment.decode(attachment) or _NO_ATTACHMENT
    payload = payload[: MAX_PAYLOAD_BYTES + 1]
    return CommandArrival(payload, known.sequence, known.gid, now_ns, attachment)
