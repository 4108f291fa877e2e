"""Names of signals, for reports on processes that a signal ended."""

from __future__ import annotations

import signal


def signal_name(number: int) -> str:
    """Return a signal's name, such as SIGABRT; real-time signals in between have none."""
    try:
        return signal.Signals(number).name
    except ValueError:
        return f"signal {number}"
