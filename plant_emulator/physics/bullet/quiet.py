"""Keeping what C code prints out of a program's output."""

from __future__ import annotations

import contextlib
import ctypes
import os
import sys
import threading
from collections.abc import Iterator

_ONE_AT_A_TIME = threading.RLock()


@contextlib.contextmanager
def quiet() -> Iterator[None]:
    """What is written to standard output and error goes nowhere meanwhile, whoever writes it.

    That goes for other threads too: to be used in the main thread, wherever there is a choice.
    """
    with _ONE_AT_A_TIME, _redirected():  # or one could put back another's /dev/null
        yield


@contextlib.contextmanager
def _redirected() -> Iterator[None]:
    flush = ctypes.CDLL(None).fflush
    sys.stdout.flush()
    kept = [os.dup(1), os.dup(2)]
    nowhere = os.open(os.devnull, os.O_WRONLY)
    try:
        flush(None)
        os.dup2(nowhere, 1)
        os.dup2(nowhere, 2)
        yield
    finally:
        flush(None)
        for descriptor, copy in enumerate(kept, start=1):
            os.dup2(copy, descriptor)
            os.close(copy)
        os.close(nowhere)
