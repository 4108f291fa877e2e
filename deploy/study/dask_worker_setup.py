"""Loaded by every worker process on this machine before its first run."""

from __future__ import annotations

import signal
from typing import Any

from deploy.study import study as study  # so that the first run does not wait for it


def dask_setup(_worker: Any) -> None:
    """Leave Ctrl-C to the command that started the worker."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
