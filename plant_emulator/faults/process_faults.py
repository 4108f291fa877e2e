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
        delay_s: after how much wall time; 0 where the plant's clock says when.
    """

    number: int
    target: Role
    verb: Verb
    delay_s: float = 0.0


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

        A plant that is gone or frozen has no clock: the end of such a fault is asked for at its
        beginning, before anything else, and comes after `for_s` of wall time.

        Args:
            index: place of the fault in the scenario.
            request: has an action done.
        """
        begin = ProcessAction(2 * index, Role(self.target), self.first)
        asked, schedule = [begin], []
        if self.last is not None and self.for_s is not None:
            end = ProcessAction(2 * index + 1, begin.target, self.last)
            if begin.target is Role.PLANT:
                asked.insert(0, end._replace(delay_s=self.for_s))
            else:
                ask_for_end = _asking(request, [end])
                schedule.append(ScheduledAction(self.end_ns, f"{self}: is over", ask_for_end))
        schedule.append(ScheduledAction(self.start_ns, f"{self}: begins", _asking(request, asked)))
        return schedule


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


def _asking(request: Request, actions: list[ProcessAction]) -> Callable[[int], None]:
    def ask(_now_ns: int) -> None:
        for action in actions:
            request(action)

    return ask
