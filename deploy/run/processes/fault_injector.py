"""Faults of processes: kills, freezes and restarts processes on the plant's request."""

from __future__ import annotations

import signal
import time
from collections.abc import Callable, Mapping

from bus_schema.messages.topics import Role
from deploy.run.processes.child import ChildProcess
from plant_emulator.faults.fault import FaultScheduler, ScheduledAction
from plant_emulator.faults.process_faults import ProcessAction

_FREEZE_TIMEOUT_S = 2.0
_POLL_S = 0.002


class ProcessFaultInjector:
    """Performs each action once, even though a restarted plant requests all of its actions again.

    Args:
        processes: the current processes by role.
        start: starts a process anew.

    Attributes:
        removed: processes that were killed and will be started again.
    """

    def __init__(
        self, processes: Mapping[Role, ChildProcess], start: Callable[[Role], None]
    ) -> None:
        self._processes = processes
        self._start = start
        self._requested: set[int] = set()
        self._later = FaultScheduler([])
        self.removed: set[Role] = set()

    def request(self, action: ProcessAction) -> None:
        """Perform a requested action, unless it was requested before."""
        if action.number in self._requested:
            return
        self._requested.add(action.number)
        self._perform(action)
        if action.then is not None:
            later = action._replace(verb=action.then)
            due_ns = time.monotonic_ns() + round(action.after_s * 1e9)
            self._later.add(ScheduledAction(due_ns, later.verb, lambda _: self._perform(later)))

    def run_due(self) -> None:
        """Perform the postponed actions that are due."""
        self._later.run_due(time.monotonic_ns())

    def _perform(self, action: ProcessAction) -> None:
        process = self._processes[action.target]
        match action.verb:
            case "kill":
                process.kill()
            case "remove":
                self.removed.add(action.target)
                process.kill()
            case "start":
                self._start(action.target)
                self.removed.discard(action.target)
            case "freeze":
                _freeze(process)
            case "resume":
                process.send(signal.SIGCONT)


def _freeze(process: ChildProcess) -> None:
    process.send(signal.SIGSTOP)
    give_up_s = time.monotonic() + _FREEZE_TIMEOUT_S
    while process.is_running() and not process.is_frozen() and time.monotonic() < give_up_s:
        time.sleep(_POLL_S)
