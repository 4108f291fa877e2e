"""Commands as processes of their own that have their libraries from the first.

To import them costs a process more than most of what it does in a test. So one process imports them
and does little else: it opens no session and runs nothing. Every command is forked from it, with
process id, signals, output and end of its own. That the command line starts from nothing too is
tested where it is looked at as a whole.
"""

from __future__ import annotations

import atexit
import gc
import io
import json
import os
import select
import signal
import socket
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager, redirect_stderr, redirect_stdout
from functools import cache
from importlib import import_module
from pathlib import Path
from typing import IO, Any, NoReturn, cast
from unittest import mock

from tests.waiting import HANG_S

ROOT = Path(__file__).resolve().parents[1]
IMPORTED = (
    "deploy.cli.processes", "deploy.cli.run_and_simulate", "deploy.cli.recorded",
    "deploy.cli.parts.study_command", "deploy.reports.html", "deploy.reports.runs.run_panels",
    "distributed.cli.dask_scheduler", "distributed.cli.dask_worker",
)  # fmt: skip
FUNNEL_HIL = "deploy.cli:main"
WITHOUT_REPORT = "tests.warm_process:without_report"
_LARGEST = 100_000


class WarmProcess:
    """A command under way: as much of `subprocess.Popen` as tests ask for.

    Args:
        words: its command line, without the name of the program.
        main: function that it calls.
        cwd: folder that it works in.
        environment: its environment variables.
    """

    def __init__(self, *words, main=FUNNEL_HIL, cwd=ROOT, environment=os.environ):
        self.returncode: int | None = None
        self._output: IO[bytes] = tempfile.TemporaryFile()  # noqa: SIM115 (closed with its last reader)
        status, its_status = os.pipe()
        self._status = os.fdopen(status, "rb", buffering=0)
        command = [list(map(str, words)), main, str(cwd), dict(environment)]
        handles = [self._output.fileno(), its_status]
        socket.send_fds(_server(), [json.dumps(command).encode()], handles)
        os.close(its_status)
        self.pid = int(self._status.readline())

    def poll(self) -> int | None:
        """Its exit code, as soon as it has one; negative: the signal that ended it."""
        return self._ended(0.0)

    def wait(self, timeout: float = HANG_S) -> int:
        """Wait for its exit code."""
        code = self._ended(timeout)
        if code is None:
            raise TimeoutError(f"process {self.pid} takes longer than {timeout} s")
        return code

    def output(self) -> str:
        """What it has written so far to stdout and stderr."""
        handle = self._output.fileno()
        return os.pread(handle, os.fstat(handle).st_size, 0).decode()

    def communicate(self, timeout: float = HANG_S) -> tuple[str, None]:
        """Wait for its end; its output."""
        self.wait(timeout)
        return self.output(), None

    def send_signal(self, number: signal.Signals) -> None:
        if self.poll() is None:
            os.kill(self.pid, number)

    def terminate(self) -> None:
        self.send_signal(signal.SIGTERM)

    def kill(self) -> None:
        self.send_signal(signal.SIGKILL)

    def _ended(self, timeout_s: float) -> int | None:
        if self.returncode is None and select.select([self._status], [], [], timeout_s)[0]:
            self.returncode = int(self._status.readline())
        return self.returncode


def here(*words: object, **environment: str) -> tuple[int, str]:
    """Run a command to its end in this process, which has its libraries already.

    Returns:
        exit code and output. Processes of a run are processes of their own all the same.
    """

    def hangs(*_: object) -> NoReturn:
        raise TimeoutError(f"{words} takes longer than {HANG_S} s")

    out, err = io.StringIO(), io.StringIO()
    numbers = (signal.SIGINT, signal.SIGTERM, signal.SIGALRM)
    handlers = {number: signal.getsignal(number) for number in numbers}
    signal.signal(signal.SIGALRM, hangs)
    signal.alarm(round(HANG_S))
    try:
        with (
            mock.patch.object(sys, "argv", ["funnel-hil", *map(str, words)]),
            mock.patch.dict(os.environ, environment),
            mock.patch("deploy.cli.parts.watched.run_watched", _call),
            mock.patch("deploy.cli.run_and_simulate.run_watched", _call),
            mock.patch("os.nice"),  # `view` lowers its priority, and nothing can raise it again
            # it also leaves the first and last CPU for good
            mock.patch("os.sched_setaffinity", create=True),
            redirect_stdout(out),
            redirect_stderr(err),
            _one_worker_here(*words),
        ):
            cast("Callable[[], None]", import_module("deploy.cli").main)()
            code: int | str | None = 0
    except SystemExit as ended:
        code = ended.code
    finally:
        signal.alarm(0)
        for number, handler in handlers.items():
            signal.signal(number, handler)
    return int(code or 0), out.getvalue() + err.getvalue()


def output_of(*words: object, code: int = 0) -> str:
    """Return the output of a command that has to end with this exit code, see `here`."""
    found, output = here(*words)
    assert found == code, output
    return output


def cold(*words: object, **environment: str) -> subprocess.CompletedProcess[str]:
    """Run a command to its end in a Python that starts from nothing."""
    return cold_python("-m", "deploy.cli", *words, **environment)


def cold_python(*words: object, **environment: str) -> subprocess.CompletedProcess[str]:
    """Run Python from nothing; it finds our packages wherever it works."""
    return subprocess.run(
        [sys.executable, *map(str, words)], capture_output=True, text=True, errors="replace",
        env={**os.environ, "PYTHONPATH": str(ROOT), "COLUMNS": "400", **environment}, check=False,
        timeout=HANG_S,
    )  # fmt: skip


def _call(work: Callable[[], dict[str, Any]]) -> dict[str, Any]:
    """Stand in for `run_watched`: a child would write to other streams, and not know our mocks."""
    return work()


@contextmanager
def _one_worker_here(*words: object) -> Iterator[None]:
    """A study with one worker does its runs in this process: another costs 3 s of CPU time."""
    if "--workers" not in words or str(words[words.index("--workers") + 1]) != "1":
        yield
        return
    from tests.deploy.study.studies import OneWorkerHere  # heavy

    with mock.patch("deploy.study.execution.dask_workers.DaskWorkers", OneWorkerHere):
        yield


@contextmanager
def no_report() -> Iterator[None]:
    """Runs are judged and leave all files but the report: to draw it costs more than to judge."""
    with mock.patch("deploy.reports.html.write_page"):
        yield


def without_report() -> None:
    """The command line with `no_report`."""
    with no_report():
        cast("Callable[[], None]", import_module("deploy.cli").main)()


@cache
def _server() -> socket.socket:
    """The process that all are forked from, started when it is first asked for."""
    ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    process = subprocess.Popen(
        [sys.executable, "-m", "tests.warm_process", str(theirs.fileno())],
        cwd=ROOT, stdin=subprocess.DEVNULL, pass_fds=[theirs.fileno()],
    )  # fmt: skip
    theirs.close()

    def stop() -> None:
        ours.close()
        process.wait(HANG_S)

    atexit.register(stop)
    return ours


def _serve(requests: socket.socket) -> None:
    """Fork a process for each request, until its clients are gone."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    for module in IMPORTED:
        import_module(module)
    import_module("deploy.scenario.scenario").load_setup("paper_arm")  # loads compiled kernels
    gc.freeze()
    while True:
        request, handles, *_ = socket.recv_fds(requests, _LARGEST, 2)
        if not request:
            break
        if os.fork() == 0:
            requests.close()
            _look_after(request, *handles)
            return
        for handle in handles:
            os.close(handle)
    while True:
        try:
            os.wait()
        except ChildProcessError:
            return


def _look_after(request: bytes, output: int, status: int) -> None:
    """Fork the command proper, tell its process id, and how it ended."""
    pid = os.fork()
    if pid == 0:
        os.close(status)
        _be(*json.loads(request), output)
        return
    os.close(output)
    os.write(status, b"%d\n" % pid)
    _, how = os.waitpid(pid, 0)
    os.write(status, b"%d\n" % os.waitstatus_to_exitcode(how))
    os._exit(0)


def _be(words: list[str], main: str, cwd: str, environment: dict[str, str], output: int) -> None:
    """Do what ``python -m`` does with this command line, in this folder."""
    os.dup2(output, 1)
    os.dup2(output, 2)
    os.close(output)
    os.chdir(cwd)
    os.environ.clear()
    os.environ.update(environment)
    sys.path[:0] = [cwd, *filter(None, environment.get("PYTHONPATH", "").split(os.pathsep))]
    sys.argv = [main, *words]
    signal.signal(signal.SIGINT, signal.default_int_handler)
    module, _, function = main.partition(":")
    getattr(import_module(module), function)()


if __name__ == "__main__":
    _serve(socket.socket(fileno=int(sys.argv[1])))
