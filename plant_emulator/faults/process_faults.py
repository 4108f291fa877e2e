"""Faults of whole processes: the plant requests them, `run` carries them out."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import ClassVar, Literal, NamedTuple

from bus_schema.configuration import Positive
from bus_schema.messages.topics import Role
from plant_emulator.faults.fault import Fault, ScheduledAction

Verb = Literal["kill", "remove", "start", "freeze", "resume"]
"""Actions on a process; a removed process will be started again, a killed one will not."""


class ProcessAction(NamedTuple):
    """An action on a process.

    Attributes:
        number: its index in the scenario. A restarted plant requests all of its actions again; the
            numbers identify those already done.
        target: the process.
        verb: the action.
        then: a second action later; None if there is none, or if the plant's clock times it.
        after_s: wall time between the two.
    """

    number: int
    target: Role
    verb: Verb
    then: Verb | None = None
    after_s: float = 0.0


Request = Callable[[ProcessAction], None]


class ProcessFault(Fault):
    """A fault of a process.

    Attributes:
        target: the process.
        first: action at the beginning of the fault.
        last: action at the end of the fault; None if it never ends.
    """

    target: Literal["controller", "plant", "recorder"]
    first: ClassVar[Verb]
    last: ClassVar[Verb | None] = None

    def schedule(self, index: int, request: Request) -> list[ScheduledAction]:
        """Return what the plant has to request, and when.

        A killed or frozen plant has no clock: the end of such a fault is requested at its
        beginning.

        Args:
            index: place of the fault in the scenario.
            request: requests an action.
        """
        begin = ProcessAction(2 * index, Role(self.target), self.first)
        schedule = []
        if begin.target is Role.PLANT:
            begin = begin._replace(then=self.last, after_s=self.for_s or 0.0)
        elif self.last is not None:
            end = ProcessAction(2 * index + 1, begin.target, self.last)
            is_over = f"{self}: is over"
            schedule.append(ScheduledAction(self.end_ns, is_over, lambda _: request(end)))
        begins = f"{self}: begins"
        return [*schedule, ScheduledAction(self.start_ns, begins, lambda _: request(begin))]


class ProcessKilled(ProcessFault):
    """SIGKILL; the process is not started again."""

    kind: Literal["process_killed"]
    for_s: None = None
    first: ClassVar[Verb] = "kill"


class ProcessFrozen(ProcessFault):
    """SIGSTOP, and SIGCONT after ``for_s`` on the plant's clock (for the plant, the wall clock)."""

    kind: Literal["process_frozen"]
    for_s: Positive
    first: ClassVar[Verb] = "freeze"
    last: ClassVar[Verb | None] = "resume"


class ProcessRestarted(ProcessFault):
    """SIGKILL, and a new process after ``for_s``, on the same clocks."""

    kind: Literal["process_restarted"]
    for_s: Positive
    first: ClassVar[Verb] = "remove"
    last: ClassVar[Verb | None] = "start"


def process_faults(faults: Iterable[Fault]) -> list[ProcessFault]:
    """Return the faults of whole processes."""
    return [fault for fault in faults if isinstance(fault, ProcessFault)]


def plant_faults(faults: Iterable[Fault]) -> tuple[Fault, ...]:
    """Return the faults that the plant emulates itself."""
    return tuple(fault for fault in faults if not isinstance(fault, ProcessFault))


def process_actions(faults: Iterable[Fault], request: Request) -> tuple[ScheduledAction, ...]:
    """Return all actions that the plant has to request for faults of processes, and when.

    Args:
        faults: all faults of the scenario, in its order.
        request: requests an action.
    """
    return tuple(
        action
        for index, fault in enumerate(faults)
        if isinstance(fault, ProcessFault)
        for action in fault.schedule(index, request)
    )
