"""`run`: recorder, plant and controller as child processes, watched until none is left."""

from __future__ import annotations

import contextlib
import ctypes
import json
import queue
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import IO, Any

from bus_schema.messages.topics import Role
from deploy.processes.process_faults import Striker
from deploy.runs.run_folder import RunFolder
from deploy.scenario.scenario import Setup

_POLL_S = 0.05
_PR_SET_PDEATHSIG = 1
_KILL_AFTER_S = 3.0
_FAREWELL_S = 2.0
_NEWCOMER_S = 20.0


@dataclass(frozen=True)
class Utterance:
    """Something a child said: its role, the kind, and the values."""

    role: Role
    kind: str
    values: dict[str, Any]


@dataclass
class RunOutcome:
    """How the processes of a run ended.

    Attributes:
        failures: one sentence for each process that failed.
        interrupted: the user stopped the run.
        grants: what real-time setup was granted, by role.
    """

    failures: list[str] = field(default_factory=list)
    interrupted: bool = False
    grants: dict[str, list[dict[str, Any]]] = field(default_factory=dict)


class Child:
    """One child process. It dies with its parent, and no signal of the terminal reaches it."""

    def __init__(
        self, role: Role, arguments: list[str], heard: queue.SimpleQueue[Utterance]
    ) -> None:
        self.role = role
        self._asked_to_stop = False
        self.faults: list[str] = []
        self.errors: list[str] = []
        self.is_there = threading.Event()
        self.process = subprocess.Popen(
            [sys.executable, "-m", "deploy.cli", *arguments, "--to-parent"],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            start_new_session=True,
            preexec_fn=_die_with_parent,
        )
        self._readers = [
            threading.Thread(target=target, args=(pipe,), daemon=True)
            for target, pipe in (
                (lambda pipe: self._listen(pipe, heard), self.process.stdout),
                (self._collect_errors, self.process.stderr),
            )
        ]
        for reader in self._readers:
            reader.start()

    def is_running(self) -> bool:
        return self.process.poll() is None

    def is_stopped(self) -> bool:
        """Whether the process is frozen by SIGSTOP."""
        try:
            stat = Path(f"/proc/{self.process.pid}/stat").read_text()
        except OSError:
            return False
        return stat.rpartition(")")[2].split()[0] in ("T", "t")

    def ask_to_stop(self) -> None:
        """Ask once; a second signal could meet an interpreter that is already shutting down."""
        if self.is_running() and not self._asked_to_stop:
            self._asked_to_stop = True
            self.process.terminate()

    def send(self, number: signal.Signals) -> None:
        if self.is_running():
            self.process.send_signal(number)

    def answer(self) -> None:
        """Tell a child that waits for it that its order was carried out."""
        if self.process.stdin is not None:
            with contextlib.suppress(OSError):
                self.process.stdin.write("done\n")
                self.process.stdin.flush()

    def kill(self) -> None:
        if self.is_running():
            self.process.kill()
        self.process.wait()

    def verdict(self) -> str | None:
        """What went wrong with the process, in one sentence; None if nothing did."""
        code = self.process.returncode
        for reader in self._readers:
            reader.join(timeout=1.0)
        if code == -signal.SIGTERM and self._asked_to_stop:
            return None  # it had not got as far as to leave in order, or was past it
        if code < 0:
            return f"the {self.role} was killed by {signal.Signals(-code).name}"
        if self.faults:
            return f"the {self.role} failed: {self.faults[0]}"
        if code:
            last = self.errors[-1] if self.errors else "it left no message"
            return f"the {self.role} failed with exit code {code}: {last}"
        return None

    def _listen(self, pipe: IO[str], heard: queue.SimpleQueue[Utterance]) -> None:
        for line in pipe:
            try:
                values = json.loads(line)
                utterance = Utterance(self.role, values.pop("kind"), values)
            except (ValueError, KeyError, AttributeError):
                self.errors.append(line.rstrip())
                continue
            if utterance.kind == "note":
                self.is_there.set()  # its first words, once it is on the bus
            elif utterance.kind == "fault":
                self.faults.append(utterance.values["text"])
            heard.put(utterance)

    def _collect_errors(self, pipe: IO[str]) -> None:
        for line in pipe:
            if line.strip():
                self.errors.append(line.rstrip())
                del self.errors[:-50]


class Launcher:
    """Runs the three processes of a scenario whose effective form is in the run folder."""

    def __init__(self, setup: Setup, folder: RunFolder) -> None:
        self._setup = setup
        self._folder = folder
        self._heard: queue.SimpleQueue[Utterance] = queue.SimpleQueue()
        self._children: dict[Role, Child] = {}
        self._striker = Striker(self._children, self._start)
        self._outcome = RunOutcome()
        self._stop_requested = False

    def request_stop(self) -> None:
        """End the run cleanly; a second request ends it at once."""
        if self._outcome.interrupted:
            for child in self._children.values():
                child.kill()
        self._stop_requested = True

    def run(self, on_utterance: Callable[[Utterance], None]) -> RunOutcome:
        """Start, watch and clear up.

        Args:
            on_utterance: called with what the children say.
        """
        try:
            for role in (Role.RECORDER, Role.PLANT, Role.CONTROLLER):
                self._start(role)
            self._watch(on_utterance)
        finally:
            self._clear_up()
        for utterance in self._utterances():
            on_utterance(utterance)
        return self._outcome

    def _start(self, role: Role) -> None:
        """Start a process, or another one in place of one that is gone."""
        scenario, log = str(self._folder.scenario), self._folder.log
        if (gone := self._children.get(role)) is not None:
            log = log.with_name(f"{log.stem}-2{log.suffix}")  # what the first one wrote stays
            if (verdict := gone.verdict()) is not None:
                self._blame(verdict)
        words = {
            Role.RECORDER: ["record", scenario, "--log", str(log)],
            Role.PLANT: ["plant", scenario, "--await-recorder"],
            Role.CONTROLLER: ["controller", scenario, "--await-recorder"],
        }
        if self._setup.link_kind.logs_frames:
            words[Role.PLANT] += ["--can-log", str(self._folder.can_log)]
        self._children[role] = child = Child(role, words[role], self._heard)
        if gone is not None and self._setup.scenario.clock == "lockstep":
            child.is_there.wait(_NEWCOMER_S)  # virtual time waits for it

    def _watch(self, on_utterance: Callable[[Utterance], None]) -> None:
        """Follow the children until the plant is done and the others had time to follow."""
        leave_by_s: float | None = None
        while self._striker.away or any(child.is_running() for child in self._children.values()):
            for utterance in self._utterances():
                on_utterance(utterance)
            self._striker.undo_what_is_due()
            plant = self._children[Role.PLANT]
            if self._stop_requested and not self._outcome.interrupted:
                self._outcome.interrupted = True
                plant.ask_to_stop()
            if self._has_gone(Role.RECORDER) and plant.is_running():
                plant.ask_to_stop()
            if self._has_gone(Role.PLANT) or self._has_gone(Role.CONTROLLER):
                # The plant has its command timeout and its stop to get through, in wall time.
                allowed_s = _KILL_AFTER_S + self._setup.scenario.link.reply_timeout_s
                if self._outcome.interrupted:
                    allowed_s = _FAREWELL_S
                leave_by_s = leave_by_s or time.monotonic() + allowed_s
            if leave_by_s is not None and time.monotonic() > leave_by_s:
                return
            time.sleep(_POLL_S)

    def _has_gone(self, role: Role) -> bool:
        return not self._children[role].is_running() and role not in self._striker.away

    def _clear_up(self) -> None:
        """No process is left over, and each one's end is accounted for."""
        stuck = [child for child in self._children.values() if child.is_running()]
        frozen = [child.role for child in stuck if child.is_stopped()]
        for child in stuck:
            child.ask_to_stop()
        give_up_s = time.monotonic() + _KILL_AFTER_S
        while any(c.is_running() and c.role not in frozen for c in stuck):
            if time.monotonic() > give_up_s:
                break
            time.sleep(_POLL_S)
        for child in self._children.values():
            was_running = child.is_running()
            child.kill()
            if child.role in frozen:
                self._blame(f"the {child.role} was frozen (stopped by a signal)")
            elif was_running:
                self._blame(f"the {child.role} did not end and was killed")
            elif (verdict := child.verdict()) is not None:
                self._blame(verdict)

    def _blame(self, verdict: str) -> None:
        """Whose fault it was comes first: a dead or frozen process before those who missed it."""
        is_root_cause = "killed by" in verdict or "frozen" in verdict
        self._outcome.failures.insert(0 if is_root_cause else len(self._outcome.failures), verdict)

    def _utterances(self) -> Iterator[Utterance]:
        while True:
            try:
                utterance = self._heard.get_nowait()
            except queue.Empty:
                return
            if utterance.kind == "grants":
                self._outcome.grants[utterance.role] = utterance.values["grants"]
            elif utterance.kind == "order":
                self._striker.hear(utterance.values)
                self._children[utterance.role].answer()
            yield utterance


def with_free_endpoints(overrides: list[str]) -> list[str]:
    """Overrides that put a run on TCP ports nobody else uses."""
    with socket.socket() as first, socket.socket() as second:
        for listener in (first, second):
            listener.bind(("127.0.0.1", 0))
        ports = [listener.getsockname()[1] for listener in (first, second)]
    return [
        *overrides,
        f"link.plant_endpoint=tcp/127.0.0.1:{ports[0]}",
        f"link.controller_endpoint=tcp/127.0.0.1:{ports[1]}",
    ]


def _die_with_parent() -> None:
    """In the child: be told to stop when the parent is gone, and never by the terminal."""
    ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGTERM)
