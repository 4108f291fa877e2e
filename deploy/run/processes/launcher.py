"""`run`: recorder, plant and controller as child processes, monitored until all have ended.

Each child is a role, defined in `roles.py` beside this file. The controller may also be a user's
program (`program.py`), or a remote one that is awaited. With a real delay there is a `relay`
between plant and controller.

The program ``python -m deploy.run.processes.launcher FOLDER PARENT_PID`` does so for a worker of a
study: they belong to this separate process, which ends with its parent.
"""

from __future__ import annotations

import json
import queue
import secrets
import sys
import time
from collections import Counter
from collections.abc import Callable
from multiprocessing import connection
from pathlib import Path

from bus_schema.messages.topics import Role
from deploy.run.network.live_feed import clear_left_behind
from deploy.run.network.real_delay import RELAY, RealDelay
from deploy.run.processes import roles
from deploy.run.processes.child import (
    Child,
    ChildProcess,
    Failure,
    LiveViewer,
    RunOutcome,
    in_causal_order,
)
from deploy.run.processes.fault_injector import ProcessFaultInjector
from deploy.run.processes.program import ControllerProcess
from deploy.run.processes.relay import relay
from deploy.run.processes.role_process import end_with_parent, thaw
from deploy.run.processes.roles import RoleOptions
from deploy.run.processes.status import StatusMessage, StatusReporter
from deploy.run.recording import record_failures
from deploy.run.run_folder import RunFolder
from deploy.run.stop_signals import on_stop
from deploy.scenario.scenario import load_setup
from deploy.scenario.setup import Setup

_POLL_S = 0.05
_KILL_AFTER_S = 3.0
_STOP_TIMEOUT_S = 2.0
_RESTART_TIMEOUT_S = 20.0


class Launcher:
    """Runs the three processes of a scenario.

    Args:
        setup: the scenario.
        folder: files of the run; the processes read the scenario there. A restarted recorder writes
            to another file: run-2.mcap, run-3.mcap and so on; likewise the frames of a CAN bus.
        delay: a real delay between controller and plant; None for none.
        awaits_controller: start no controller, but wait for a remote one.
        viewer: function of a live view, called with the run's folder; None for no live view.
    """

    def __init__(
        self,
        setup: Setup,
        folder: RunFolder,
        *,
        delay: RealDelay | None = None,
        awaits_controller: bool = False,
        viewer: Callable[[Path, StatusReporter], int] | None = None,
    ) -> None:
        self._setup, self._folder, self._delay, self._view = setup, folder, delay, viewer
        self._roles = [Role.RECORDER, Role.PLANT, *([] if awaits_controller else [Role.CONTROLLER])]
        self._overrides = [] if delay is None else [delay.override]
        self._inbox: queue.SimpleQueue[StatusMessage] = queue.SimpleQueue()
        self._children: dict[Role, ChildProcess] = {}
        self._relay: Child | None = None
        self._viewer: LiveViewer | None = None
        self._starts: Counter[Role] = Counter()
        self._run_key = f"f{secrets.token_hex(8)[1:]}"  # a session's id must not begin with 0
        self._injector = ProcessFaultInjector(self._children, self._start)
        self._outcome = RunOutcome()
        self._failures: list[Failure] = []
        self._stop_requested = False
        self._has_begun = self._plant_has_failed = self._program_left_first = False

    def request_stop(self) -> None:
        """End the run cleanly; a second request ends it at once."""
        thaw()
        if self._outcome.interrupted:
            viewers = [] if self._viewer is None else [self._viewer]
            for child in [*self._all_children(), *viewers]:
                child.kill()
        self._stop_requested = True

    def run(self, on_message: Callable[[StatusMessage], None]) -> RunOutcome:
        """Start, monitor and clean up.

        Args:
            on_message: called with the children's status messages.
        """
        try:
            if self._view is not None:  # first of all, so that it misses nothing
                self._viewer = LiveViewer(self._view, self._folder.path, self._inbox)
                self._handle_messages(on_message)
            if self._delay is not None:
                options = self._delay.options
                self._relay = Child(RELAY, relay, options, self._folder.path, self._inbox)
            for role in self._roles:
                self._start(role)
            self._watch(on_message)
        finally:
            self._clear_up()
            if self._viewer is not None:
                self._viewer.end()
            clear_left_behind()
        self._handle_messages(on_message)
        self._failures = in_causal_order(self._failures)
        self._note_suspicion()
        self._outcome.failures = [failure.text for failure in self._failures]
        self._outcome.is_bad_input = any(failure.is_bad_input for failure in self._failures)
        for start in range(1, self._starts[Role.RECORDER] + 1):
            record_failures(_numbered(self._folder.log, start), self._outcome.failures)
        return self._outcome

    def _start(self, role: Role) -> None:
        """Start a process, or replace one that has ended."""
        gone = self._children.get(role)
        if gone is not None:
            self._note_failure(gone.failure())
        self._starts[role] += 1
        child = self._child(role)
        self._children[role] = child
        if gone is not None and self._setup.scenario.clock == "lockstep":
            child.has_started.wait(_RESTART_TIMEOUT_S)  # in virtual time, the run waits for it

    def _child(self, role: Role) -> ChildProcess:
        """Start and return a process of a role."""
        link, controller = self._setup.scenario.link, self._setup.scenario.controller
        if role is Role.CONTROLLER and controller.process is not None:
            place = link.plant_endpoint if self._delay is None else self._delay.endpoint
            return ControllerProcess(self._setup, self._folder.scenario, place)
        log = {Role.RECORDER: self._folder.log, Role.PLANT: self._folder.can_log}.get(role)
        options = RoleOptions(
            str(self._folder.scenario),
            overrides=self._overrides if role is Role.CONTROLLER else [],
            await_recorder=True,
            log=None if log is None else _numbered(log, self._starts[role]),
            run_key=self._run_key,
        )
        return Child(role, roles.ROLES[role], options, self._folder.path, self._inbox)

    def _watch(self, on_message: Callable[[StatusMessage], None]) -> None:
        """Monitor the children until the plant has ended and the others had time to follow."""
        leave_by_s: float | None = None
        while self._injector.removed or self._one_of_ours_is_running():
            self._handle_messages(on_message)
            self._injector.run_due()
            plant = self._children[Role.PLANT]
            if self._stop_requested and not self._outcome.interrupted:
                self._outcome.interrupted = True
                self._ask_to_stop()
            if self._has_gone(Role.RECORDER) or self._relay_has_gone():
                plant.ask_to_stop()
            self._stop_program_or_peers()
            if self._has_gone(Role.PLANT) or self._has_gone(Role.CONTROLLER):
                leave_by_s = leave_by_s or time.monotonic() + self._time_to_leave_s()
            if leave_by_s is not None and time.monotonic() > leave_by_s:
                return
            running = [child.sentinel for child in self._all_children() if child.is_running()]
            connection.wait(running, _POLL_S)

    def _ask_to_stop(self) -> None:
        """Ask children to stop at the plant's end; the controller too, unless it leads the run."""
        if self._setup.link_kind.controller_leads and Role.CONTROLLER in self._children:
            self._children[Role.CONTROLLER].ask_to_stop()
        self._children[Role.PLANT].ask_to_stop()

    def _one_of_ours_is_running(self) -> bool:
        ours = (
            child for child in self._children.values() if not isinstance(child, ControllerProcess)
        )
        return any(child.is_running() for child in ours)

    def _stop_program_or_peers(self) -> None:
        """Stop the user's program after the run, or the processes that wait for it in vain."""
        program = self._children.get(Role.CONTROLLER)
        if not isinstance(program, ControllerProcess):
            return
        if self._has_gone(Role.CONTROLLER) and self._inbox.empty() and not self._plant_has_failed:
            self._program_left_first = True
        if self._has_gone(Role.PLANT):
            program.ask_to_stop()
            waiting = Role.RECORDER  # it may not have found the plant
        elif self._has_gone(Role.CONTROLLER):
            waiting = Role.PLANT  # it would wait for the program in vain
        else:
            return
        child = self._children[waiting]
        if not self._has_begun and child.has_started.is_set():  # earlier, a signal would kill it
            child.ask_to_stop()

    def _time_to_leave_s(self) -> float:
        """Return the wall time that the plant needs to leave: its command timeout and its stop."""
        if self._outcome.interrupted:
            return _STOP_TIMEOUT_S
        plant = self._setup.scenario.plant
        stopping_s = 1e-3 * plant.command_timeout_ms + plant.stop_duration_s
        return _KILL_AFTER_S + self._setup.scenario.link.reply_timeout_s + stopping_s

    def _has_gone(self, role: Role) -> bool:
        child = self._children.get(role)
        return child is not None and not child.is_running() and role not in self._injector.removed

    def _relay_has_gone(self) -> bool:
        return self._relay is not None and not self._relay.is_running()

    def _all_children(self) -> list[ChildProcess]:
        return [*self._children.values(), *([] if self._relay is None else [self._relay])]

    def _clear_up(self) -> None:
        """End all processes, and note how each one ended."""
        thaw()
        early = self._relay if self._relay_has_gone() else None  # it must outlast the others
        frozen = self._ask_all_to_stop()
        for child in self._all_children():
            failure = _end(child, was_frozen=child in frozen, is_early=child is early)
            self._note_failure(failure)

    def _ask_all_to_stop(self) -> list[ChildProcess]:
        """Give the running children time to stop; return those that are frozen and cannot."""
        stuck = [child for child in self._all_children() if child.is_running()]
        frozen = [child for child in stuck if child.is_frozen()]
        for child in stuck:
            child.ask_to_stop()
        give_up_s = time.monotonic() + _KILL_AFTER_S
        while any(child.is_running() and child not in frozen for child in stuck):
            if time.monotonic() > give_up_s:
                break
            time.sleep(_POLL_S)
        return frozen

    def _note_suspicion(self) -> None:
        """Note the program's part in a failure: it may be the cause even if it did not fail."""
        program = self._children.get(Role.CONTROLLER)
        if not isinstance(program, ControllerProcess) or program.failure() is not None:
            return
        if self._failures or not (self._has_begun or self._outcome.interrupted):
            awaited = any(failure.awaited == Role.CONTROLLER for failure in self._failures)
            gave_up = awaited and not self._program_left_first
            self._note_failure(program.suspicion(plant_gave_up_first=gave_up))

    def _note_failure(self, failure: Failure | None) -> None:
        if failure is not None:
            self._failures.insert(0 if failure.is_cause else len(self._failures), failure)

    def _handle_messages(self, on_message: Callable[[StatusMessage], None]) -> None:
        while not self._inbox.empty():
            message = self._inbox.get()
            if message.kind == "progress" or message.values.get("ticks"):
                self._has_begun = True
            if message.kind == "fault" and message.role == Role.PLANT:
                self._plant_has_failed = True
            if message.kind == "realtime":
                self._outcome.realtime[message.role] = message.values["settings"]
            elif message.kind == "result" and message.role == RELAY:
                self._outcome.relay = message.values
            elif message.kind == "process_action":
                self._injector.request(message.values["action"])
                self._children[Role(message.role)].confirm()
            on_message(message)


def _end(child: ChildProcess, *, was_frozen: bool, is_early: bool) -> Failure | None:
    """Kill a child if it still runs; note how it ended."""
    was_running = child.is_running()
    child.kill()
    if was_frozen:
        return Failure(f"the {child.role} was frozen (stopped by a signal)", is_cause=True)
    if was_running and not isinstance(child, ControllerProcess):
        return Failure(f"the {child.role} did not end and was killed", is_cause=False)
    failure = child.failure()
    if failure is None and is_early:
        return Failure(f"the {child.role} ended before the run did", is_cause=True)
    return failure


def _numbered(path: Path, number: int) -> Path:
    """Return the file of this number in a series from 1: run.mcap, run-2.mcap and so on."""
    return path if number == 1 else path.with_name(f"{path.stem}-{number}{path.suffix}")


def _main(path: Path, parent_pid: int) -> None:
    """Start the processes of a run; write their failures to standard output."""
    folder = RunFolder(path)
    setup = load_setup(str(folder.scenario))
    launcher = Launcher(setup, folder)
    on_stop(launcher.request_stop)
    end_with_parent(parent_pid)
    outcome = launcher.run(lambda _message: None)
    print(json.dumps(outcome.failures))


if __name__ == "__main__":
    _main(Path(sys.argv[1]), int(sys.argv[2]))
