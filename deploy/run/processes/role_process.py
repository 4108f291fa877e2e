"""A separate process, forked from one that has few threads: a role of a run, or a program.

A role is a function that runs with our libraries already loaded. A user's program replaces the
whole process image.
"""

from __future__ import annotations

import logging
import multiprocessing
import os
import signal
import socket
import sys
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from multiprocessing.connection import Connection, wait
from pathlib import Path
from types import FrameType
from typing import TYPE_CHECKING, Any, NamedTuple, NoReturn, TypeVar

from setproctitle import setproctitle

from bus_schema.runtime.child import PR_SET_PDEATHSIG, set_process_option
from deploy.run.exit_codes import with_exit_codes
from deploy.run.stop_signals import STOPS, stop_at_once

if TYPE_CHECKING:  # the fork server starts before `run` loads the libraries, and loads them too
    from deploy.run.processes.status import StatusReporter

CANNOT_START = 127
"""Exit code of a program that could not be started, as in shells."""
_LOST = 255
"""Exit code of a process whose fork server was killed."""
_LEAVE_WITHIN_S = 30
"""Longer than any process needs to leave in order."""
Options = TypeVar("Options")


class _ForkServer(NamedTuple):
    """The fork server of this process.

    Attributes:
        pid: its process id.
        door: takes requests; the server ends when it is closed.
    """

    pid: int
    door: socket.socket

    def is_running(self) -> bool:
        try:
            return os.waitpid(self.pid, os.WNOHANG) == (0, 0)
        except ChildProcessError:  # of the process that this one was forked from
            return False


_server: list[_ForkServer] = []
"""At most one."""


class RoleProcess:
    """A process that the fork server has forked.

    Attributes:
        pid: its process id.
        exitcode: its exit code, negative for a signal; None while it runs.
    """

    def __init__(self, pid: int, server: Connection) -> None:
        self.pid, self._server = pid, server
        self._code: int | None = None

    @property
    def sentinel(self) -> int:
        """Handle by which `multiprocessing.connection.wait` waits for the end of the process."""
        return self._server.fileno()

    @property
    def exitcode(self) -> int | None:
        self.join(0.0)
        return self._code

    def is_alive(self) -> bool:
        """Whether it runs."""
        return self.exitcode is None

    def join(self, timeout_s: float | None = None) -> None:
        """Wait until it has ended."""
        if self._code is None and wait([self._server], timeout_s):
            try:
                self._code = self._server.recv()
            except (EOFError, OSError):
                self._code = _LOST

    def kill(self) -> None:
        """Kill it."""
        if self.is_alive():
            with suppress(ProcessLookupError):
                os.kill(self.pid, signal.SIGKILL)


class _Surroundings(NamedTuple):
    """Context of a process, besides its function.

    Attributes:
        environment: its environment variables.
        outputs: files to which its standard output and error are appended.
        fork_server: id of the process that it is forked from.
    """

    environment: dict[str, str]
    outputs: tuple[Path, Path]
    fork_server: int

    def enter(self) -> None:
        """Apply them; from here on, no signal of the terminal reaches this process."""
        os.setsid()
        os.environ.clear()
        os.environ.update(self.environment)
        os.dup2(os.open(os.devnull, os.O_RDONLY), 0)
        for number, path in enumerate(self.outputs, start=1):
            os.dup2(os.open(path, os.O_WRONLY | os.O_CREAT | os.O_APPEND, 0o644), number)


def prepare() -> None:
    """Start the fork server, which loads the program in the background.

    Call it in the main thread. The server ends with this process. It is in the process group that a
    terminal, or `timeout`, stops, and survives the signals meant for this process.
    """
    if _server and _server[0].is_running():
        return
    ours, theirs = socket.socketpair()
    with theirs:
        theirs.set_inheritable(True)
        command = [sys.executable, "-P", "-m", "deploy.run.processes.fork_server"]
        pid = os.posix_spawn(
            sys.executable, [*command, str(theirs.fileno())], os.environ, setsigmask=STOPS
        )
    _server[:] = [_ForkServer(pid, ours)]


def start_role(
    role: str,
    function: Callable[[Options, StatusReporter], int],
    options: Options,
    folder: Path,
    output: Path,
) -> tuple[RoleProcess, Connection]:
    """Start a role in this folder; from the main thread. It ends with this process.

    Args:
        role: name of the process.
        function: its function; returns the exit code.
        options: arguments of the function, besides a reporter.
        folder: the run's folder.
        output: file for its output, and that of a law in it.

    Returns:
        the process, and the connection for its reports.
    """
    ours, theirs = multiprocessing.Pipe()
    with theirs:
        arguments = (role, function, options, folder)
        process = _fork(_run_role, os.environ, (output, output), *arguments, channel=theirs)
    return process, ours


def start_program(
    command: Sequence[str], environment: Mapping[str, str], stdout: Path, stderr: Path
) -> RoleProcess:
    """Start a program in this folder, in a separate process group; from the main thread.

    It is killed when this process ends, and no signal of the terminal reaches it.

    Args:
        command: the program and its arguments.
        environment: all of its environment variables.
        stdout: file for its standard output.
        stderr: file for its standard error.
    """
    return _fork(_run_program, environment, (stdout, stderr), list(command))


def thaw() -> None:
    """Resume the fork server if it is frozen (stopped by a signal).

    While it is frozen, no child's end is noticed.
    """
    for server in _server:
        with suppress(ProcessLookupError):
            os.kill(server.pid, signal.SIGCONT)


def end_with_parent(parent_pid: int) -> None:
    """Make this process leave in order when its parent is gone, even if it is stopped by then.

    It requests SIGCONT from Linux: only that and SIGKILL reach a stopped process, and SIGKILL would
    leave no time to finish a file. Call it first, in the main thread. On other systems it does
    nothing.

    Args:
        parent_pid: process id of the parent, which may be gone already.
    """

    def leave_without_parent(_number: int = 0, _frame: FrameType | None = None) -> None:
        if os.getppid() != parent_pid:
            signal.alarm(_LEAVE_WITHIN_S)  # ends a process that does not leave in time
            os.kill(os.getpid(), signal.SIGTERM)

    signal.signal(signal.SIGCONT, leave_without_parent)
    set_process_option(PR_SET_PDEATHSIG, signal.SIGCONT)
    leave_without_parent()


def _fork(
    target: Callable[..., None],
    environment: Mapping[str, str],
    outputs: tuple[Path, Path],
    *arguments: Any,
    channel: Connection | None = None,
) -> RoleProcess:
    """Start a process; a stop request can end the wait for a frozen fork server.

    Raises:
        ChildProcessError: the fork server was ended meanwhile.
    """
    prepare()
    server = _server[0]
    surroundings = _Surroundings(dict(environment), outputs, server.pid)
    ours, theirs = multiprocessing.Pipe()
    handles = [each.fileno() for each in (theirs, channel) if each is not None]
    try:
        with theirs:
            socket.send_fds(server.door, [b"-"], handles)
        ours.send((sys.path, os.getcwd()))  # noqa: PTH109
        ours.send((target, (surroundings, *arguments)))
        return RoleProcess(ours.recv(), ours)
    except (EOFError, ConnectionError) as error:
        raise ChildProcessError(
            "the process from which this run forks its processes was killed"
        ) from error


def _run_role(
    channel: Connection,
    surroundings: _Surroundings,
    role: str,
    function: Callable[[Any, StatusReporter], int],
    options: Any,
    folder: Path,
) -> None:
    """Call the function, and exit as a command does."""
    from deploy.run.processes.status import StatusReporter

    title = f"{sys.executable} -m deploy.cli {role} {folder}"  # for `ps` and similar tools
    setproctitle(title.encode(errors="replace").decode())  # finds its place by the old environment
    surroundings.enter()
    stop_at_once()
    with with_exit_codes():
        end_with_parent(surroundings.fork_server)
        signal.pthread_sigmask(signal.SIG_UNBLOCK, STOPS)
        reporter = StatusReporter(role, channel)
        _set_up_output(reporter)
        sys.exit(function(options, reporter))


class _Reporting(logging.Handler):
    """Reports warnings about the bus, which otherwise stand only in the output of a process."""

    def __init__(self, reporter: StatusReporter) -> None:
        super().__init__()
        self._reporter = reporter

    def emit(self, record: logging.LogRecord) -> None:
        self._reporter.report("warning", text=record.getMessage())


def _set_up_output(reporter: StatusReporter) -> None:
    """Write all output at once, and report when kernels are compiled."""
    from bus_schema.runtime import compiled

    def is_written(record: logging.LogRecord) -> bool:
        if record.msg != compiled.COMPILES:
            return True
        reporter.report("compiles")
        return False

    sys.stdout.reconfigure(line_buffering=True)  # type: ignore[union-attr]
    compiled.logger.addFilter(is_written)
    logging.basicConfig(level=logging.ERROR, format="%(message)s")
    bus = logging.getLogger("bus_schema")
    bus.setLevel(logging.WARNING)
    bus.addHandler(_Reporting(reporter))
    logging.getLogger("plant_emulator").setLevel(logging.CRITICAL)


def _run_program(surroundings: _Surroundings, command: list[str]) -> NoReturn:
    """Replace this process by the program."""
    folder = Path.cwd()
    surroundings.enter()
    # Its parent, the fork server, ends with the requesting process.
    set_process_option(PR_SET_PDEATHSIG, signal.SIGKILL)
    signal.signal(signal.SIGPIPE, signal.SIG_DFL)  # ignored by Python, and inherited by programs
    signal.pthread_sigmask(signal.SIG_UNBLOCK, STOPS)
    try:
        os.chdir(folder)
        os.execvpe(command[0], command, surroundings.environment)
    except OSError as error:
        os.write(2, f"{command[0]}: {error.strerror}\n".encode(errors="replace"))
        os._exit(CANNOT_START)
