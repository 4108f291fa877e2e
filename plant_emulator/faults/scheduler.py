"""Actions at given instants: the one schedule of all faults."""

from __future__ import annotations

from bisect import insort
from collections.abc import Callable, Iterable
from typing import NamedTuple


def do_nothing(_now_ns: int) -> None:
    """Do nothing: the action of an entry that is only reported."""


def report_nothing(_description: str) -> None:
    """Report nothing: for a schedule that is only carried out."""


class ScheduledAction(NamedTuple):
    """One entry of a schedule.

    Attributes:
        at_ns: when, on the scheduler's clock.
        description: what happens, in a few words.
        action: called with the time.
    """

    at_ns: int
    description: str
    action: Callable[[int], None] = do_nothing


class FaultScheduler:
    """Carries out actions at their times.

    Args:
        actions: in any order; actions of the same instant are carried out in the given order.
    """

    def __init__(self, actions: Iterable[ScheduledAction]) -> None:
        self._pending = sorted(actions, key=_instant)

    def add(self, action: ScheduledAction) -> None:
        """Add an action to the schedule."""
        insort(self._pending, action, key=_instant)

    def postpone(self, by_ns: int) -> None:
        """Postpone all remaining actions."""
        self._pending = [each._replace(at_ns=each.at_ns + by_ns) for each in self._pending]

    def run_due(self, now_ns: int, report: Callable[[str], None] = report_nothing) -> None:
        """Carry out each action that is due at `now_ns`, once.

        Args:
            now_ns: the time, on the same clock as the actions' instants.
            report: called with the description of each action before it is done.
        """
        while self._pending and self._pending[0].at_ns <= now_ns:
            due = self._pending.pop(0)
            report(due.description)
            due.action(now_ns)


def _instant(action: ScheduledAction) -> int:
    return action.at_ns
