"""Names of signals, for what is said of processes that they ended."""

from __future__ import annotations

import signal


def signal_name(number: int) -> str:
    """SIGABRT, for instance; real-time signals between the first and the last have no name."""
    try:
        return signal.Signals(number).name
    except ValueError:
        return f"signal {number}"
