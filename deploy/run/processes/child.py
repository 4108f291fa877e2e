"""A child process of a run."""

from __future__ import annotations

import contextlib
import os
import queue
import signal
import threading
import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

from bus_schema.runtime.child import how_it_ended, last_line
from deploy.run.exit_codes import BAD_INPUT, INTERRUPTED
from deploy.run.processes.role_process import Options, RoleProcess, start_role
from deploy.run.processes.status import StatusMessage, StatusReporter

SILENT = "it printed no message"
_LAST_BYTES = 65_536
_LONGEST_LINE = 2000
_MESSAGES_TIMEOUT_S = 1.0
VIEWER = "viewer"
_VIEWER_STARTS_WITHIN_S, _VIEWER_STOPS_WITHIN_S = 20.0, 3.0
_POLL_S = 0.05


class Failure(NamedTuple):
    """Failure of a process.

    Attributes:
        text: one sentence.
        is_cause: other failures are its consequences: it was killed or frozen from outside, or
            reports itself as the cause.
        is_bad_input: its inputs conflict, such as two different scenarios.
        role: the role of ours that failed by itself; empty for other processes and other ends.
        awaited: the peer whose silence it is; empty if it is another failure.
    """

    text: str
    is_cause: bool = False
    is_bad_input: bool = False
    role: str = ""
    awaited: str = ""


@dataclass
class RunOutcome:
    """Outcome of the processes of a run.

    Attributes:
        failures: one sentence for each process that failed; causes come before consequences.
        interrupted: the user stopped the run.
        is_bad_input: one of our processes found that its inputs conflict.
        realtime: requested real-time settings, by role.
        relay: report of the relay of a real delay; empty without one.
    """

    failures: list[str] = field(default_factory=list)
    interrupted: bool = False
    is_bad_input: bool = False
    realtime: dict[str, list[dict[str, Any]]] = field(default_factory=dict)
    relay: dict[str, Any] = field(default_factory=dict)


def in_causal_order(failures: Sequence[Failure]) -> list[Failure]:
    """Sort failures: a process's own failure comes before its silence."""
    failed = {failure.role for failure in failures} - {""}
    return sorted(failures, key=lambda each: each.awaited in failed)


class ChildProcess(ABC):
    """A child process. It ends with its parent, and receives no signals of the terminal.

    Args:
        role: what it is called.
        errors: file that its standard error will be appended to.

    Attributes:
        has_started: set once it is on the bus, as far as known.
    """

    _process: RoleProcess
    """The process, once it is started."""

    def __init__(self, role: str, errors: Path) -> None:
        self.role = role
        self.has_started = threading.Event()
        self._errors = errors
        self._errors_before = errors.stat().st_size if errors.exists() else 0
        self._was_asked_to_stop = False

    def is_running(self) -> bool:
        return self._process.is_alive()

    @property
    def sentinel(self) -> int:
        """Handle by which `multiprocessing.connection.wait` waits for the end of the process."""
        return self._process.sentinel

    def is_frozen(self) -> bool:
        """Whether the process is stopped by a signal."""
        try:
            stat = Path(f"/proc/{self._process.pid}/stat").read_text()
        except OSError:
            return False
        return stat.rpartition(")")[2].split()[0] in ("T", "t")

    def ask_to_stop(self) -> None:
        """Request a stop, once: a second signal could hit an interpreter during its shutdown."""
        if self.is_running() and not self._was_asked_to_stop:
            self._was_asked_to_stop = True
            self.send(signal.SIGTERM)

    def send(self, number: signal.Signals) -> None:
        """Send a signal."""
        if self.is_running():
            with contextlib.suppress(ProcessLookupError):  # it has just ended
                os.kill(self._process.pid, number)

    def confirm(self) -> None:  # noqa: B027 (a program waits for nothing)
        """Confirm to a waiting child that its requested action is done."""

    def kill(self) -> None:
        """Kill it, and wait until it has ended."""
        if self.is_running():
            self._process.kill()
        self._process.join()

    def _last_line(self) -> str:
        """Return the last line on its standard error."""
        try:
            with self._errors.open("rb") as file:
                file.seek(max(self._errors_before, file.seek(0, os.SEEK_END) - _LAST_BYTES))
                return last_line(file.read())[:_LONGEST_LINE] or SILENT
        except OSError:
            return SILENT

    @abstractmethod
    def failure(self) -> Failure | None:
        """Return the failure of the ended process; None if there is none."""


class Child(ChildProcess):
    """A role of ours, which reports its status.

    Args:
        role: what it is called.
        function: what it does; returns its exit code.
        options: arguments of the function, besides a reporter.
        folder: the run's folder; it gets a file with the role's output, if any.
        inbox: takes the messages it sends.
    """

    def __init__(
        self,
        role: str,
        function: Callable[[Options, StatusReporter], int],
        options: Options,
        folder: Path,
        inbox: queue.SimpleQueue[StatusMessage],
    ) -> None:
        super().__init__(role, folder / f"{role}_output.log")
        self._process, self._channel = start_role(role, function, options, folder, self._errors)
        self._inbox = inbox
        self._faults: list[Failure] = []
        self._reader = threading.Thread(target=self._read_messages, daemon=True)
        self._reader.start()

    def confirm(self) -> None:
        with contextlib.suppress(OSError):
            self._channel.send("done")

    def kill(self) -> None:
        super().kill()
        with contextlib.suppress(OSError):
            if not self._errors.stat().st_size:
                self._errors.unlink()

    def failure(self) -> Failure | None:
        code = self._process.exitcode or 0
        self._reader.join(timeout=_MESSAGES_TIMEOUT_S)
        if code == -signal.SIGTERM and self._was_asked_to_stop:
            return None  # it had not reached an orderly exit, or had passed it
        if code == INTERRUPTED and not self._faults:
            return None  # it was asked to stop, by any process, and left in order
        if code < 0:
            return Failure(f"the {self.role} was {how_it_ended(code)}", is_cause=True)
        if self._faults:
            return self._faults[0]._replace(is_bad_input=code == BAD_INPUT)
        if code:
            text = f"the {self.role} failed with exit code {code}: {self._last_line()}"
            return Failure(text, is_bad_input=code == BAD_INPUT, role=self.role)
        return None

    def _read_messages(self) -> None:
        with contextlib.suppress(Exception):  # its end, or bytes of a law that are no message
            while True:
                message = StatusMessage(self.role, *self._channel.recv())
                if message.kind == "note":
                    self.has_started.set()
                elif message.kind == "fault":
                    values = dict(message.values)
                    values["text"] = f"the {self.role} failed: {values['text']}"
                    self._faults.append(Failure(**values, role=self.role))
                self._inbox.put(message)


class LiveViewer(Child):
    """The viewer of `run --live`; the constructor returns once it is ready, or has failed.

    Args:
        view: function of the process, called with the folder and a reporter.
        folder: the run's folder, with the scenario in force.
        inbox: takes its reports; the first contains its addresses.
    """

    def __init__(
        self,
        view: Callable[[Path, StatusReporter], int],
        folder: Path,
        inbox: queue.SimpleQueue[StatusMessage],
    ) -> None:
        super().__init__(VIEWER, view, folder, folder, inbox)
        give_up_s = time.monotonic() + _VIEWER_STARTS_WITHIN_S
        while self.is_running() and time.monotonic() < give_up_s:
            if self.has_started.wait(_POLL_S):
                return

    def end(self) -> None:
        """End it; a failure is reported, but does not fail the run."""
        self.ask_to_stop()
        if not self.is_frozen():
            self._process.join(_VIEWER_STOPS_WITHIN_S)
        was_running = self.is_running()
        self.kill()
        failure = None if was_running else self.failure()
        if failure is not None:
            text = f"{failure.text}; the run continued without it"
            self._inbox.put(StatusMessage(VIEWER, "fault", {"text": text}))
