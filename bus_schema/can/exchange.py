"""A CAN bus inside the process: what one node sends, all others receive, a batch at a time.

Threads that wait for one another cost more than all frames of a cycle do. So one node may leave its
turns to the node that waits for its frames: both then run in one thread, one after the other.
"""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Iterator, Sequence
from queue import Empty, SimpleQueue

from bus_schema.can.frame import CanFrame

_POLL_S = 0.05


class FrameExchange:
    """A bus.

    Attributes:
        nodes: who is on it.
        guest: a node that leaves its turns to the others.
    """

    def __init__(self) -> None:
        self.nodes: list[ExchangeNode] = []
        self.guest: ExchangeNode | None = None

    def join(self) -> ExchangeNode:
        """Return a new node, which receives all frames that others send from now on."""
        node = ExchangeNode(self)
        self.nodes.append(node)
        return node


class ExchangeNode:
    """One node's access to a `FrameExchange`, see `CanBus`; for one thread at a time.

    Attributes:
        inbox: batches of frames that have come.
    """

    def __init__(self, exchange: FrameExchange) -> None:
        self._exchange = exchange
        self._received: deque[CanFrame] = deque()
        self.inbox: SimpleQueue[Sequence[CanFrame]] = SimpleQueue()
        self._turns: Iterator[None] = iter(())  # those that it leaves to the others
        self._turning = threading.Lock()
        self._has_turned = threading.Event()  # set once there are no more turns
        self._failure: Exception | None = None

    def send(self, frame: CanFrame) -> None:
        self.send_all((frame,))

    def send_all(self, frames: Sequence[CanFrame]) -> None:
        batch = tuple(frames)
        for node in self._exchange.nodes:
            if node is not self and batch:
                node.inbox.put(batch)

    def receive(self, timeout_s: float) -> CanFrame | None:
        if not self._received:
            guest = self._exchange.guest
            if guest is not None and guest is not self and timeout_s > 0.0:
                self._turn_until_frame(guest, timeout_s)
                timeout_s = timeout_s if guest._has_turned.is_set() else 0.0
            try:
                self._received.extend(self.inbox.get(timeout=timeout_s))
            except Empty:
                return None
        return self._received.popleft()

    def dropped(self) -> int | None:
        return None  # nothing can be: queues have no end

    def close(self) -> None:
        if self in self._exchange.nodes:
            self._exchange.nodes.remove(self)

    def leave_turns(self, turns: Iterator[None]) -> None:
        """Let other nodes run this node's turns while they wait for frames; return after the last.

        Args:
            turns: each ends where others have to send something. This node runs the first one, and
                the rest once it is alone on the bus.

        Raises:
            Exception: any error of the turns.
        """
        self._turns = turns
        self._turn()
        self._exchange.guest = self
        while not self._has_turned.wait(_POLL_S):
            if self._exchange.nodes in ([self], []):
                self._turn()
        self._exchange.guest = None
        if self._failure is not None:
            raise self._failure

    def _turn(self) -> None:
        """Make one turn; what it raises is for the node that left its turns."""
        with self._turning:
            try:
                next(self._turns)
            except StopIteration:
                self._has_turned.set()
            except Exception as error:  # noqa: BLE001 (raised again by `leave_turns`)
                self._failure = error
                self._has_turned.set()

    def _turn_until_frame(self, guest: ExchangeNode, timeout_s: float) -> None:
        """Run turns of a guest until one of them sends something, or the timeout."""
        give_up_s = time.monotonic() + timeout_s
        while self.inbox.empty() and not guest._has_turned.is_set():
            guest._turn()
            if time.monotonic() > give_up_s:
                break
