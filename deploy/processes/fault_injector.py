"""Strikes whole processes, when the plant says that it is time."""

from __future__ import annotations

import signal
import time
from collections.abc import Callable, Mapping
from typing import Any, Protocol

from bus_schema.messages.topics import Role
from deploy.scenario.faults import Blow, Order

_PATIENCE_S = 2.0
_POLL_S = 0.002


class Target(Protocol):
    """What is struck."""

    def is_running(self) -> bool:
        """Whether the process is there."""
        ...

    def is_stopped(self) -> bool:
        """Whether it is frozen."""
        ...

    def kill(self) -> None:
        """Kill it, and wait until it is gone."""
        ...

    def send(self, number: signal.Signals) -> None:
        """Send a signal."""
        ...


class Striker:
    """Carries out orders, each once: a plant that was restarted has the same schedule again.

    Args:
        targets: the processes by role, as they are at any time.
        start: starts a process anew.

    Attributes:
        away: processes that were killed and will be back.
    """

    def __init__(self, targets: Mapping[Role, Target], start: Callable[[Role], None]) -> None:
        self._targets = targets
        self._start = start
        self._done: set[Order] = set()
        self._due: list[tuple[float, Order]] = []
        self.away: set[Role] = set()

    def hear(self, values: Mapping[str, Any]) -> None:
        """Carry out an order that came as the JSON of `order_values`."""
        undone_by = values["undone_by"]
        order = Order(
            Role(values["target"]), Blow(values["blow"]),
            Blow(undone_by) if undone_by else None, values["for_s"],
        )  # fmt: skip
        if order in self._done:
            return
        self._done.add(order)
        self._strike(order.target, order.blow)
        if order.undone_by is not None:
            due_s = time.monotonic() + order.for_s
            self._due.append((due_s, Order(order.target, order.undone_by)))

    def undo_what_is_due(self) -> None:
        """End the faults whose time on the wall is over."""
        now_s = time.monotonic()
        for due_s, order in list(self._due):
            if due_s <= now_s:
                self._due.remove((due_s, order))
                self._strike(order.target, order.blow)

    def _strike(self, role: Role, blow: Blow) -> None:
        target = self._targets[role]
        match blow:
            case Blow.KILL:
                target.kill()
            case Blow.TAKE_AWAY:
                self.away.add(role)
                target.kill()
            case Blow.BRING_BACK:
                self._start(role)
                self.away.discard(role)
            case Blow.FREEZE:
                target.send(signal.SIGSTOP)
                give_up_s = time.monotonic() + _PATIENCE_S
                while target.is_running() and not target.is_stopped():
                    if time.monotonic() > give_up_s:
                        return
                    time.sleep(_POLL_S)
            case Blow.THAW:
                target.send(signal.SIGCONT)


def order_values(order: Order) -> dict[str, Any]:
    """An order as values for JSON."""
    return order._asdict()
