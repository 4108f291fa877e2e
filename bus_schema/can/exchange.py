"""A CAN bus inside the process: what one node sends, all others receive, a batch at a time.

Threads that wait for one another cost more than all frames of a cycle do. So one node may leave its
turns to whoever waits for its frames: both then go on in one thread, one after the other.
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
        guest: turns that a node leaves to the others.
    """

    def __init__(self) -> None:
        self.nodes: list[ExchangeNode] = []
        self.guest: _Guest | None = None

    def join(self) -> ExchangeNode:
        """A new node, which hears what others send from now on."""
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
            if guest is not None and guest.node is not self and timeout_s > 0.0:
                guest.run_until_heard(self.inbox, timeout_s)
                timeout_s = 0.0 if not guest.is_over.is_set() else timeout_s
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
        """Have the others make this node's turns when they wait for frames, and wait for the last.

        Args:
            turns: each ends where others have to send something. The first one is made here, and
                so are all once there are no others any longer.

        Raises:
            Exception: whatever the turns raise.
        """
        guest = _Guest(self, turns)
        guest.step()
        self._exchange.guest = guest
        while not guest.is_over.wait(_POLL_S):
            if self._exchange.nodes in ([self], []):
                guest.step()
        self._exchange.guest = None
        if guest.failure is not None:
            raise guest.failure


class _Guest:
    """A node whose turns another thread makes.

    Attributes:
        node: the node.
        is_over: set once there are no more turns.
        failure: what was raised in the last one.
    """

    def __init__(self, node: ExchangeNode, turns: Iterator[None]) -> None:
        self.node = node
        self.is_over = threading.Event()
        self.failure: Exception | None = None
        self._turns = turns
        self._lock = threading.Lock()

    def step(self) -> None:
        """Make one turn; what it raises is for the owner of the turns."""
        with self._lock:
            try:
                next(self._turns)
            except StopIteration:
                self.is_over.set()
            except Exception as error:  # noqa: BLE001 (raised again by `leave_turns`)
                self.failure = error
                self.is_over.set()

    def run_until_heard(self, inbox: SimpleQueue[Sequence[CanFrame]], timeout_s: float) -> None:
        """Make a turn, and more until one of them sends something or it takes too long."""
        give_up_s = time.monotonic() + timeout_s
        while inbox.empty() and not self.is_over.is_set():
            self.step()
            if time.monotonic() > give_up_s:
                break
