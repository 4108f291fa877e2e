"""A separate process, forked from one that has few threads: a role of a run, or a program.

A role is a function that runs with our libraries already loaded. A user's program replaces the
whole process image.
"""

from __future__ import annotations

import atexit
import logging
import multiprocessing
import os
import signal
import sys
import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from multiprocessing import forkserver, resource_tracker
from multiprocessing.connection import Connection
from multiprocessing.process import BaseProcess
from pathlib import Path
from types import FrameType
from typing import TYPE_CHECKING, Any, NamedTuple, NoReturn, TypeVar

from setproctitle import setproctitle

from bus_schema.runtime.child import PR_SET_PDEATHSIG, set_process_option
from bus_schema.safe_path import safe_path
from deploy.run.exit_codes import with_exit_codes
from deploy.run.stop_signals import STOPS, stop_at_once

if TYPE_CHECKING:  # the fork server starts before `run` loads the libraries, and loads them too
    from deploy.run.processes.status import StatusReporter

_CONTEXT = multiprocessing.get_context("forkserver")
_CONTEXT.set_forkserver_preload(["deploy.run.processes.fork_server"])
CANNOT_START = 127
"""Exit code of a program that could not be started, as in shells."""
_LONG_PATH = 60
"""Of the 107 characters allowed in a socket's path, Python uses 32."""
_LEAVE_WITHIN_S = 30
"""Longer than any process needs to leave in order."""
Options = TypeVar("Options")
_sockets: list[int] = []
"""At most one: the file descriptor of the connection to the fork server."""


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

    Call it in the main thread. The server ends with this process.
    """
    with _shielded_fork_server(), _socket_without_a_path():
        forkserver.ensure_running()


def start_role(
    role: str,
    function: Callable[[Options, StatusReporter], int],
    options: Options,
    folder: Path,
    output: Path,
) -> tuple[BaseProcess, Connection]:
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
    ours, theirs = _CONTEXT.Pipe()
    with theirs:
        arguments = (role, function, options, theirs, folder)
        process = _fork(_run_role, os.environ, (output, output), *arguments)
    return process, ours


def start_program(
    command: Sequence[str], environment: Mapping[str, str], stdout: Path, stderr: Path
) -> BaseProcess:
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

    While it is frozen, no child's end is noticed. Its resource tracker is resumed too.
    """
    for pid in (forkserver._forkserver._forkserver_pid, resource_tracker._resource_tracker._pid):  # type: ignore[attr-defined]
        if pid is not None:
            with suppress(ProcessLookupError):
                os.kill(pid, signal.SIGCONT)


atexit.register(thaw)


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
) -> BaseProcess:
    """Start a process; a stop request can end the wait for a frozen fork server.

    Raises:
        ChildProcessError: the fork server was ended meanwhile.
    """
    prepare()
    server: int = forkserver._forkserver._forkserver_pid  # type: ignore[attr-defined]
    surroundings = _Surroundings(dict(environment), outputs, server)
    process = _CONTEXT.Process(target=target, args=(surroundings, *arguments), daemon=True)
    try:
        process.start()
    except EOFError as error:
        raise ChildProcessError(
            "the process from which this run forks its processes was killed"
        ) from error
    return process


@contextmanager
def _shielded_fork_server() -> Iterator[None]:
    """Let a fork server start that survives signals meant for this process.

    It is in the process group that a terminal, or `timeout`, stops. Also, modules in the current
    folder must not replace ours.
    """
    with safe_path():
        resource_tracker.ensure_running()  # it would let the signals through
        signals = signal.pthread_sigmask(signal.SIG_BLOCK, STOPS)
        try:
            yield
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, signals)


@contextmanager
def _socket_without_a_path() -> Iterator[None]:
    """Let a fork server start whose socket has no path: its file is removed at once.

    A killed process could not remove it. Without Linux, it stays until the end. The path must be
    short, unlike some values of TMPDIR.
    """
    if sys.platform != "linux":
        yield
        return
    server: Any = forkserver._forkserver
    settings: dict[str, Any] = multiprocessing.current_process()._config  # type: ignore[attr-defined]
    others, parent = settings.get("tempdir"), tempfile.gettempdir()
    place = parent if len(parent) < _LONG_PATH else "/tmp"
    with tempfile.TemporaryDirectory(prefix="pymp-", dir=place) as folder:
        settings["tempdir"] = folder
        try:
            yield
        finally:
            settings["tempdir"] = others
        if server._forkserver_address.startswith(folder):
            while _sockets:  # of an ended fork server
                os.close(_sockets.pop())
            _sockets.append(os.open(server._forkserver_address, os.O_PATH))
            server._forkserver_address = f"/proc/self/fd/{_sockets[0]}"


def _run_role(
    surroundings: _Surroundings,
    role: str,
    function: Callable[[Any, StatusReporter], int],
    options: Any,
    channel: Connection,
    folder: Path,
) -> None:
    """Call the function, and exit as a command does."""
    from deploy.run.processes.status import StatusReporter

    title = f"{sys.executable} -m deploy.cli {role} {folder}"  # for `ps` and similar tools
    setproctitle(title.encode(errors="replace").decode())  # finds its place by the old environment
    surroundings.enter()
    launcher = multiprocessing.parent_process()
    if launcher is None or not launcher.is_alive():  # from here on its end is noticed
        return
    stop_at_once()
    with with_exit_codes():
        end_with_parent(surroundings.fork_server)
        signal.pthread_sigmask(signal.SIG_UNBLOCK, STOPS)
        reporter = StatusReporter(role, channel)
        _set_up_output(reporter)
        sys.exit(function(options, reporter))


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
    logging.getLogger("bus_schema").setLevel(logging.WARNING)
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
