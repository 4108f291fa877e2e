"""Run a user's law in a child process, so that it can end or alter nothing in this one."""

from __future__ import annotations

import contextlib
import json
import multiprocessing
import os
import signal
import sys
from collections.abc import Callable
from multiprocessing.connection import Connection
from typing import Any

from bus_schema.runtime.child import (
    PR_SET_CHILD_SUBREAPER,
    PR_SET_PDEATHSIG,
    how_it_ended,
    set_process_option,
)
from deploy.run import closed_output
from deploy.run.execute import InProcess, JudgedRun, recorded
from deploy.run.exit_codes import FAULT, with_exit_codes
from deploy.run.processes.child import RunOutcome
from deploy.run.run_folder import RunFolder
from deploy.run.stop_signals import STOPS
from deploy.scenario.setup import Setup

_WATCHED = {*STOPS, signal.SIGCHLD}
Work = Callable[[], dict[str, Any]]


def run_watched(work: Work) -> dict[str, Any]:
    """Do work in a child of this process, and return its answer once its group has ended.

    A custom law may end the process it runs in, by `os._exit` or in C, with exit code 0. Without an
    answer, this process ends with the child's exit code, or with 1. The answer comes as JSON.
    A request to stop reaches the child first, and the handlers of this process afterwards.
    """
    fork = multiprocessing.get_context("fork")
    reader, writer = fork.Pipe(duplex=False)
    child = fork.Process(target=_answer, args=(work, writer))
    set_process_option(PR_SET_CHILD_SUBREAPER, 1)  # so that it can wait for all of the group
    signal.pthread_sigmask(signal.SIG_BLOCK, _WATCHED)
    child.start()
    writer.close()
    code, requests = _end_of(child.pid or 0)
    answer: dict[str, Any] | None = None
    with contextlib.suppress(EOFError, OSError, ValueError):
        answer = json.loads(reader.recv_bytes() if reader.poll() else b"")
    if code < 0:
        print(f"error: the simulation was {how_it_ended(code)}", file=sys.stderr)
        with contextlib.suppress(OSError):  # of SIGKILL, which cannot be handled
            signal.signal(-code, signal.SIG_DFL)
        requests = [-code]
    if code == 0 and answer is None:
        print("error: the law ended the process before the run was judged", file=sys.stderr)
        code = FAULT
    if code > 0:
        sys.exit(code)
    signal.pthread_sigmask(signal.SIG_UNBLOCK, _WATCHED)
    for number in requests:
        signal.raise_signal(number)
    return answer or {}


class Watched:
    """Runs in virtual time in a child process, and judges the recording in this one."""

    def run(self, setup: Setup, folder: RunFolder | None) -> JudgedRun:
        assert folder is not None

        def work() -> dict[str, Any]:
            InProcess().run(setup, folder)
            return {}

        run_watched(work)
        return recorded(folder, RunOutcome(), setup)


def _answer(work: Work, writer: Connection) -> None:
    os.setpgid(0, 0)  # Ctrl-C reaches it once, by its parent
    set_process_option(PR_SET_PDEATHSIG, signal.SIGKILL)
    signal.pthread_sigmask(signal.SIG_UNBLOCK, _WATCHED)
    closed_output.parent_reports = True
    child = os.getpid()
    with with_exit_codes():
        answer = json.dumps(work()).encode()
    if os.getpid() == child:  # a law that forked returns twice
        writer.send_bytes(answer)


def _end_of(child: int) -> tuple[int, list[int]]:
    """Forward signals to a child until it ends, then kill what is left of its process group.

    Returns:
        its exit code, negative for a signal, and the signals.
    """
    requests = []
    while os.waitid(os.P_PID, child, os.WEXITED | os.WNOHANG | os.WNOWAIT) is None:
        number = signal.sigwaitinfo(_WATCHED).si_signo
        if number != signal.SIGCHLD:
            requests.append(number)
            os.kill(child, number)
    with contextlib.suppress(ProcessLookupError, PermissionError):  # there is no other
        os.killpg(child, signal.SIGKILL)
    _, status = os.waitpid(child, 0)
    with contextlib.suppress(ChildProcessError):
        while True:
            os.waitpid(-child, 0)
    return os.waitstatus_to_exitcode(status), requests
