"""Roles for tests: what a process of a run could do."""

from __future__ import annotations

import os
import signal
import time
from pathlib import Path
from typing import Any

from deploy.run.exit_codes import FINISHED, INTERRUPTED
from deploy.run.processes.roles import RoleOptions, recorder
from deploy.run.processes.status import StatusReporter
from deploy.run.stop_signals import StopRequest


def prints(exit_code: int, reporter: StatusReporter) -> int:
    """Print what looks like a message, and report another one."""
    print('{"kind": "realtime"}')
    reporter.report("note", text=str(Path.cwd()))
    return exit_code


def waits(_options: Any, reporter: StatusReporter) -> int:
    """Wait to be ended."""
    print("waits")
    reporter.report("note", text="waits")
    while True:
        time.sleep(0.01)


class _AsksToStop:
    def __del__(self) -> None:
        os.kill(os.getpid(), signal.SIGTERM)


def loses_a_request(_options: object, _reporter: StatusReporter) -> int:
    """Is asked to stop in a destructor, where what the signal raises is lost; whether it knows."""
    _AsksToStop()
    return INTERRUPTED if StopRequest().is_set else FINISHED


def records_late(options: RoleOptions, reporter: StatusReporter) -> int:
    """Be a recorder on a busy machine."""
    time.sleep(1.0)
    return recorder(options, reporter)
