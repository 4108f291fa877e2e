"""Faults of whole processes: the plant asks for them, `run` carries them out."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import ClassVar, Literal, NamedTuple

from bus_schema.configuration import Positive
from bus_schema.messages.topics import Role
from plant_emulator.faults.fault import Fault
from plant_emulator.faults.scheduler import ScheduledAction

Verb = Literal["kill", "remove", "start", "freeze", "resume"]
"""What can be done to a process; one that is removed will be started again, a killed one not."""


class ProcessAction(NamedTuple):
    """Something to be done to a process.

    Attributes:
        number: its place in the scenario. A plant that was restarted asks for all of its actions
            again; by their numbers those that were done are known.
        target: the process.
        verb: what is done to it.
        then: what is done to it afterwards; None where nothing is, or where the plant's clock says
            when.
        after_s: how much wall time is between the two.
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
        first: what is done to it when the fault begins.
        last: what is done to it when the fault is over; None where it never is.
    """

    target: Literal["controller", "plant", "recorder"]
    first: ClassVar[Verb]
    last: ClassVar[Verb | None] = None

    def schedule(self, index: int, request: Request) -> list[ScheduledAction]:
        """What the plant has to ask for, and when.

        A plant that is gone or frozen has no clock: how such a fault ends is asked for at its
        beginning.

        Args:
            index: place of the fault in the scenario.
            request: has an action done.
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
    """SIGKILL, and it stays away."""

    kind: Literal["process_killed"]
    for_s: None = None
    first: ClassVar[Verb] = "kill"


class ProcessFrozen(ProcessFault):
    """SIGSTOP, and SIGCONT after ``for_s``, of the plant's clock; of the wall's for the plant."""

    kind: Literal["process_frozen"]
    for_s: Positive
    first: ClassVar[Verb] = "freeze"
    last: ClassVar[Verb | None] = "resume"


class ProcessRestarted(ProcessFault):
    """SIGKILL, and a new process in its place after ``for_s``, likewise."""

    kind: Literal["process_restarted"]
    for_s: Positive
    first: ClassVar[Verb] = "remove"
    last: ClassVar[Verb | None] = "start"


def process_faults(faults: Iterable[Fault]) -> list[ProcessFault]:
    """The faults of whole processes."""
    return [fault for fault in faults if isinstance(fault, ProcessFault)]


def plant_faults(faults: Iterable[Fault]) -> tuple[Fault, ...]:
    """The faults that the plant emulates by itself."""
    return tuple(fault for fault in faults if not isinstance(fault, ProcessFault))


def process_actions(faults: Iterable[Fault], request: Request) -> tuple[ScheduledAction, ...]:
    """All that the plant has to ask for, and when, for the faults of processes.

    Args:
        faults: all faults of the scenario, in its order.
        request: has an action done.
    """
    return tuple(
        action
        for index, fault in enumerate(faults)
        if isinstance(fault, ProcessFault)
        for action in fault.schedule(index, request)
    )
