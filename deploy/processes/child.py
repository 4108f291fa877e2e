"""One process of a run, as `run` sees it."""

from __future__ import annotations

import contextlib
import os
import queue
import signal
import threading
from abc import ABC, abstractmethod
from collections.abc import Sequence
from multiprocessing.process import BaseProcess
from pathlib import Path
from typing import IO, NamedTuple

from bus_schema.errors import silent_peer
from bus_schema.runtime.compiled import COMPILES
from bus_schema.runtime.signal_names import signal_name
from deploy.exit_codes import BAD_INPUT, INTERRUPTED
from deploy.processes.command_process import start
from deploy.processes.status import StatusMessage

_LAST_LINES = 50
_OUTPUT_TIMEOUT_S = 1.0


class Failure(NamedTuple):
    """How a process failed.

    Attributes:
        text: one sentence.
        is_cause: other failures are its consequences: it was killed or frozen from outside, or says
            so itself.
        is_bad_input: it was given what does not go together, a scenario and another one say.
    """

    text: str
    is_cause: bool
    is_bad_input: bool = False


def in_causal_order(failures: Sequence[str]) -> list[str]:
    """Sentences about failures; that a process which failed itself was silent comes last."""

    def is_consequence(text: str) -> bool:
        peer = silent_peer(text)
        return peer is not None and any(
            other.startswith(f"the {peer} failed") for other in failures
        )

    return sorted(failures, key=is_consequence)


class ChildProcess(ABC):
    """One child process. It ends with its parent, and no signal of the terminal reaches it.

    Args:
        role: what it is called.
        process: it, started.

    Attributes:
        has_started: set once it is on the bus, as far as that can be known.
    """

    def __init__(self, role: str, process: BaseProcess) -> None:
        self.role = role
        self.has_started = threading.Event()
        self._process = process
        self._was_asked_to_stop = False

    def is_running(self) -> bool:
        return self._process.is_alive()

    @property
    def sentinel(self) -> int:
        """What `multiprocessing.connection.wait` takes to wait for its end."""
        return self._process.sentinel

    def is_frozen(self) -> bool:
        """Whether the process is stopped by a signal."""
        try:
            stat = Path(f"/proc/{self._process.pid}/stat").read_text()
        except OSError:
            return False
        return stat.rpartition(")")[2].split()[0] in ("T", "t")

    def ask_to_stop(self) -> None:
        """Ask once; a second signal could meet an interpreter that is already shutting down."""
        if self.is_running() and not self._was_asked_to_stop:
            self._was_asked_to_stop = True
            self.send(signal.SIGTERM)

    def send(self, number: signal.Signals) -> None:
        """Send a signal."""
        if self._process.pid is not None and self.is_running():
            with contextlib.suppress(ProcessLookupError):  # it has ended just now
                os.kill(self._process.pid, number)

    def join(self, timeout_s: float) -> None:
        """Wait for its end, but not for longer."""
        self._process.join(timeout_s)

    def confirm(self) -> None:  # noqa: B027 (a program waits for nothing)
        """Tell a child that waits for it that what it asked for is done."""

    def kill(self) -> None:
        """Kill it, and wait until it is gone."""
        if self.is_running():
            self._process.kill()
        self._process.join()

    @abstractmethod
    def failure(self) -> Failure | None:
        """What went wrong with the process, which has ended; None if nothing did."""


class Child(ChildProcess):
    """A command of ours, which reports.

    Args:
        role: what it is called.
        arguments: words of its command line.
        inbox: takes the messages it sends.
    """

    def __init__(
        self, role: str, arguments: list[str], inbox: queue.SimpleQueue[StatusMessage]
    ) -> None:
        command = start(arguments)
        super().__init__(role, command.process)
        self._inbox = inbox
        self._stdin = command.stdin
        self._faults: list[Failure] = []
        self._errors: list[str] = []
        self._readers = [
            threading.Thread(target=read, args=(pipe,), daemon=True)
            for read, pipe in (
                (self._read_messages, command.stdout),
                (self._read_errors, command.stderr),
            )
        ]
        for reader in self._readers:
            reader.start()

    def confirm(self) -> None:
        with contextlib.suppress(OSError):
            self._stdin.write("done\n")
            self._stdin.flush()

    def failure(self) -> Failure | None:
        code = self._process.exitcode or 0
        for reader in self._readers:
            reader.join(timeout=_OUTPUT_TIMEOUT_S)
        if code == -signal.SIGTERM and self._was_asked_to_stop:
            return None  # it had not got as far as to leave in order, or was past it
        if code == INTERRUPTED and not self._faults:
            return None  # it was asked to stop, by whomever, and left in order
        if code < 0:
            return Failure(f"the {self.role} was killed by {signal_name(-code)}", is_cause=True)
        if self._faults:
            return self._faults[0]._replace(is_bad_input=code == BAD_INPUT)
        if code:
            last = self._errors[-1] if self._errors else "it left no message"
            text = f"the {self.role} failed with exit code {code}: {last}"
            return Failure(text, is_cause=False, is_bad_input=code == BAD_INPUT)
        return None

    def _read_messages(self, pipe: IO[str]) -> None:
        for line in pipe:
            try:
                message = StatusMessage.parse(self.role, line)
            except ValueError:
                self._errors.append(line.rstrip())
                continue
            if message.kind == "note":
                self.has_started.set()
            elif message.kind == "fault":
                text = f"the {self.role} failed: {message.values['text']}"
                self._faults.append(Failure(text, message.values.get("is_cause", False)))
            self._inbox.put(message)

    def _read_errors(self, pipe: IO[str]) -> None:
        for line in pipe:
            if line.rstrip() == COMPILES:
                self._inbox.put(StatusMessage(self.role, "compiles", {}))
            elif line.strip():
                self._errors.append(line.rstrip())
                del self._errors[:-_LAST_LINES]
