"""Common base of all scheduled faults, and the one schedule of all of them."""

from __future__ import annotations

from bisect import insort
from collections.abc import Callable, Iterable
from typing import Annotated, NamedTuple

from pydantic import Field

from bus_schema.configuration import (
    ConfigurationError,
    NonNegative,
    Number,
    Positive,
    StrictModel,
)

FOREVER_NS = 1 << 62
Share = Annotated[Number, Field(gt=0, le=1)]


class FaultContext(NamedTuple):
    """Context in which a fault is checked.

    Attributes:
        joint_names: names of the robot's joints.
        duration_s: length of the run.
        payload_kg: mass that the arm carries when the fault begins.
        no_link_faults: what is allowed instead of faults of messages, if the plant cannot change
            this link's messages; None if it can.
        no_duplicates: what is allowed instead of duplicated messages, if the link's transport
            delivers nothing twice; None if it can.
    """

    joint_names: tuple[str, ...]
    duration_s: float
    payload_kg: float
    no_link_faults: str | None
    no_duplicates: str | None


class Fault(StrictModel):
    """Keys that all faults have.

    Attributes:
        kind: which fault.
        at_s: start, on the run's clock.
        for_s: duration; if optional and left out, the fault lasts to the end of the run.
    """

    kind: str
    at_s: NonNegative
    for_s: Positive | None = None

    @property
    def start_ns(self) -> int:
        return round(self.at_s * 1e9)

    @property
    def end_ns(self) -> int:
        return FOREVER_NS if self.for_s is None else round((self.at_s + self.for_s) * 1e9)

    def is_active(self, now_ns: int) -> bool:
        return self.start_ns <= now_ns < self.end_ns

    def check(self, key: str, context: FaultContext) -> None:
        """Check the fault against its scenario.

        Args:
            key: its key in the scenario.
            context: what it may refer to.

        Raises:
            ConfigurationError: it refers to something that does not exist, or begins after the end.
        """
        if self.at_s >= context.duration_s:
            allowed = f"below duration_s = {context.duration_s}"
            raise ConfigurationError(f"{key}.at_s", self.at_s, allowed)

    def __str__(self) -> str:
        """Describe the fault in a few words: its kind, and its own values."""
        common = ("kind", "at_s", "for_s")
        own = [f"{key} {value}" for key, value in self if key not in common and value is not None]
        return ", ".join([self.kind, *own])


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
