"""Commands as they come to the plant, kept until its loop takes them."""

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
Note = Callable[[Delivery, CommandArrival], None]
_NO_ATTACHMENT = Attachment(sequence=0, source_time_ns=0, gid=b"")


class Arrivals:
    """A thread waits for commands, so that each is stamped when it comes whatever the loop does.

    Args:
        inbox: where they come in; waited for by nobody else.
        clock: the plant's clock, which stamps them.
        note: called with each command as it came, and as it is taken in.

    Attributes:
        received: how many came.
        overflow: how many of them were left out, because too many waited to be taken.
    """

    def __init__(self, inbox: Inbox, clock: Clock, note: Note) -> None:
        self._inbox, self._clock, self._note = inbox, clock, note
        self._kept: queue.SimpleQueue[CommandArrival] = queue.SimpleQueue()
        self._first: list[CommandArrival] = []
        self._closed = threading.Event()
        self.received = self.overflow = 0
        self._thread = threading.Thread(target=self._receive, daemon=True)
        self._thread.start()

    def is_empty(self) -> bool:
        """Whether none waits to be taken."""
        return not self._first and self._kept.empty()

    def await_one(self, timeout_s: float) -> bool:
        """Wait for a command that was not yet taken; whether there is one."""
        if not self._first:
            try:
                self._first.append(self._kept.get(timeout=timeout_s))
            except queue.Empty:
                return False
        return True

    def take(self) -> list[CommandArrival]:
        """All that came since the last call, in order."""
        taken, self._first = self._first, []
        taken.extend(self._kept.get_nowait() for _ in range(self._kept.qsize()))
        return taken

    def close(self) -> None:
        """End the thread: one that comes out of Zenoh while Python ends aborts the process."""
        self._closed.set()
        self._inbox.knock()
        self._thread.join()
        self._inbox.close()

    def _receive(self) -> None:
        while True:  # whoever knocks at a full inbox waits until there is room
            delivery = self._inbox.wait()
            if delivery is not None:
                self._admit(delivery)
            elif self._closed.is_set():
                return

    def _admit(self, delivery: Delivery) -> None:
        self.received += 1
        if self._kept.qsize() >= LARGEST_BACKLOG:
            self.overflow += 1  # a flood: what comes after is no use, and memory is bounded
            return
        arrival = arrival_of(delivery.payload, delivery.attachment, self._clock.now_ns())
        self._note(delivery, arrival)
        self._kept.put(arrival)


class AwaitedArrivals(Arrivals):
    """In virtual time the loop waits for commands itself, which saves the thread's hand-over.

    The thread then only ends its waits, and takes in what comes while nobody waits: a full inbox
    would hold up all else that comes over the network.
    """

    def __init__(self, inbox: Inbox, clock: Clock, note: Note) -> None:
        self._is_taking = threading.Lock()
        super().__init__(inbox, clock, note)

    def close(self) -> None:
        self._closed.set()
        while self._thread.is_alive():  # it may be knocking at a full inbox
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
    """A command as the plant takes it in; a sender without an attachment has no name."""
    known = Attachment.decode(attachment) or _NO_ATTACHMENT
    return CommandArrival(payload[: MAX_PAYLOAD_BYTES + 1], known.sequence, known.gid, now_ns)
