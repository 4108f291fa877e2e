"""A process of its own, forked from one that has few threads: a command of ours, or a program.

A command finds the libraries of the command line loaded; a program of the user's own takes the
place of all that is there.
"""

from __future__ import annotations

import atexit
import ctypes
import multiprocessing
import os
import runpy
import shutil
import signal
import sys
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from multiprocessing import forkserver, resource_tracker
from multiprocessing.connection import Connection
from multiprocessing.process import BaseProcess
from pathlib import Path
from typing import IO, NamedTuple, NoReturn

from setproctitle import setproctitle

from deploy.processes.parent import FOR_FORK_SERVER, PR_SET_PDEATHSIG, PROGRAM, SAFE_PATH
from deploy.stop_signals import STOPS

_CONTEXT = multiprocessing.get_context("forkserver")
_CONTEXT.set_forkserver_preload(["deploy.processes.fork_server"])
CANNOT_START = 127
"""Exit code of a program that could not be started, as shells have it."""
_LONG_PATH = 60
"""Of the 107 characters that the path of a socket may have, 32 are Python's own."""


class CommandProcess(NamedTuple):
    """A command under way, and this side of its standard streams."""

    process: BaseProcess
    stdin: IO[str]
    stdout: IO[str]
    stderr: IO[str]


def prepare() -> None:
    """Have the process that others are forked from load the program, as this one does meanwhile.

    To be called in the main thread. It ends with this process.
    """
    with _fork_server_survives():
        forkserver.ensure_running()


def start(words: list[str]) -> CommandProcess:
    """Start `funnel-hil` with these words, in this folder; from the main thread.

    It ends with this process, and no signal of the terminal reaches it.
    """
    (stdin, to_it), (from_it, stdout), (errors, stderr) = (
        _CONTEXT.Pipe(duplex=False) for _ in range(3)
    )
    theirs = [stdin, stdout, stderr]
    process = _CONTEXT.Process(target=_be, args=(words, Path.cwd(), theirs), daemon=True)
    _fork(process)
    for end in theirs:
        end.close()
    return CommandProcess(process, _file(to_it, "w"), _file(from_it, "r"), _file(errors, "r"))


def start_program(
    command: Sequence[str], environment: Mapping[str, str], stdout: Path, stderr: Path
) -> BaseProcess:
    """Start a program in this folder, in a process group of its own; from the main thread.

    It is killed when this process ends, and no signal of the terminal reaches it.

    Args:
        command: the program and its arguments.
        environment: all of its environment variables.
        stdout: file that takes its standard output.
        stderr: file that takes its standard error.
    """
    arguments = (list(command), dict(environment), Path.cwd(), (stdout, stderr))
    process = _CONTEXT.Process(target=_be_program, args=arguments, daemon=True)
    _fork(process)
    return process


def thaw() -> None:
    """Have what processes are forked from go on where it is frozen (stopped by a signal).

    Until then nobody's end is noticed. So does the process that clears up after it.
    """
    for pid in (forkserver._forkserver._forkserver_pid, resource_tracker._resource_tracker._pid):  # type: ignore[attr-defined]
        if pid is not None:
            with suppress(ProcessLookupError):
                os.kill(pid, signal.SIGCONT)


atexit.register(thaw)


def remove_sockets() -> None:
    """Remove the folder of the fork server's socket, which Python does at a regular end alone."""
    folder = multiprocessing.current_process()._config.get("tempdir")  # type: ignore[attr-defined]
    if folder is not None:
        shutil.rmtree(folder, ignore_errors=True)


def _fork(process: BaseProcess) -> None:
    """Start a process; a request to stop can end the wait for a fork server that is frozen.

    Raises:
        ChildProcessError: something ended the fork server meanwhile.
    """
    prepare()
    try:
        process.start()
    except EOFError as error:
        raise ChildProcessError("what this run's processes are forked from was killed") from error


@contextmanager
def _fork_server_survives() -> Iterator[None]:
    """For a fork server to be started: nothing that is meant for this process ends it.

    It is in the process group that a terminal, or `timeout`, tells to stop; the path of its
    socket must be short, which not every TMPDIR is; and modules in this folder are not to take the
    place of ours.
    """
    resource_tracker.ensure_running()  # which would let the signals through
    signals = signal.pthread_sigmask(signal.SIG_BLOCK, STOPS)
    folder = tempfile.gettempdir()
    tempfile.tempdir = folder if len(folder) < _LONG_PATH else "/tmp"
    is_ours = os.environ.setdefault(SAFE_PATH, FOR_FORK_SERVER) == FOR_FORK_SERVER
    try:
        yield
    finally:
        if is_ours:
            del os.environ[SAFE_PATH]
        tempfile.tempdir = folder
        signal.pthread_sigmask(signal.SIG_SETMASK, signals)


def _file(end: Connection, mode: str) -> IO[str]:
    with end:
        return os.fdopen(os.dup(end.fileno()), mode)


def _be(words: list[str], folder: Path, streams: list[Connection]) -> None:
    """Be the command."""
    os.setsid()
    signal.pthread_sigmask(signal.SIG_UNBLOCK, STOPS)
    os.chdir(folder)
    for number, stream in enumerate(streams):
        os.dup2(stream.fileno(), number)
        stream.close()
    sys.stdin = open(0, closefd=False)  # noqa: SIM115
    sys.stdout = open(1, "w", errors="replace", closefd=False)  # noqa: SIM115
    sys.stderr = open(2, "w", buffering=1, errors="backslashreplace", closefd=False)  # noqa: SIM115
    words = [*words, "--to-parent", str(os.getppid())]
    title = " ".join([sys.executable, "-m", PROGRAM, *words])
    setproctitle(title.encode(errors="replace").decode())  # for `ps` and the like
    launcher = multiprocessing.parent_process()
    if launcher is not None and launcher.is_alive():  # from here on its end is noticed
        sys.argv[1:] = words
        try:
            runpy.run_module(PROGRAM, run_name="__main__", alter_sys=True)
        finally:
            if not launcher.is_alive():
                remove_sockets()


def _be_program(
    command: list[str], environment: dict[str, str], folder: Path, outputs: tuple[Path, Path]
) -> NoReturn:
    """Be the program."""
    os.setsid()
    if sys.platform == "linux":  # its parent, the fork server, ends with whoever asked for it
        ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, signal.SIGKILL)
    signal.signal(signal.SIGPIPE, signal.SIG_DFL)  # which Python ignores, and programs inherit
    signal.pthread_sigmask(signal.SIG_UNBLOCK, STOPS)
    os.dup2(os.open(os.devnull, os.O_RDONLY), 0)
    for number, path in enumerate(outputs, start=1):
        os.dup2(os.open(path, os.O_WRONLY | os.O_CREAT | os.O_APPEND, 0o644), number)
    try:
        os.chdir(folder)
        os.execvpe(command[0], command, environment)
    except OSError as error:
        os.write(2, f"{command[0]}: {error.strerror}\n".encode(errors="replace"))
        os._exit(CANNOT_START)
