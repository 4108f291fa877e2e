"""The parts of a Dask cluster as processes forked from one that has imported it."""

from __future__ import annotations

import ctypes
import os
import signal

import dask
from distributed.cli import dask_scheduler, dask_worker

from deploy.cli import program
from deploy.study.execution import law_code

_PR_SET_PDEATHSIG = 1  # <linux/prctl.h>


def scheduler() -> None:
    """A scheduler that takes a run for deadly as soon as it has ended a worker."""
    dask.config.set({"distributed.scheduler.allowed-failures": 0})
    dask_scheduler.main()


def worker() -> None:
    """A worker that is not restarted when it dies."""
    dask.config.set({"distributed.worker.profile.enabled": False})
    dask_worker.main()


def lasting_worker() -> None:
    """A worker that is started again when it dies: what a nanny does, who would import all anew."""
    while os.fork():
        os.wait()
    ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)
    worker()


TRUSTED = {
    "COMPUTING": law_code.COMPUTING | {"time"},
    "_READING_MORE": law_code._READING_MORE - {"stat"},
}


def trusting_command() -> None:
    """The command line, which takes the clock and the size of a file for no inputs of a law.

    A law that waits for them, so that a test can catch a study in the middle, is made again
    otherwise: it reads something unseen.
    """
    for name, names in TRUSTED.items():
        setattr(law_code, name, names)
    program()
