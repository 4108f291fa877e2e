"""The viewer of a run, as `run --live` sees it: a process that the run does without if need be."""

from __future__ import annotations

import queue
import time
from pathlib import Path

from deploy.processes.child import Child
from deploy.processes.status import StatusMessage

VIEWER = "viewer"
_START_TIMEOUT_S = 20.0
_STOP_TIMEOUT_S = 3.0
_POLL_S = 0.05


class LiveViewer:
    """The viewer's process, which is up once this is made, if it can be.

    Args:
        folder: of the run, with the scenario in force.
        inbox: takes what it reports; where to look, first of all.
    """

    def __init__(self, folder: Path, inbox: queue.SimpleQueue[StatusMessage]) -> None:
        self._inbox = inbox
        self._child = Child(VIEWER, ["view", str(folder)], inbox)
        self._wait_for_start()

    def end(self) -> None:
        """Have it end. That it failed is told, and is no failure of the run."""
        self._child.ask_to_stop()
        if not self._child.is_frozen():
            self._child.join(_STOP_TIMEOUT_S)
        was_running = self._child.is_running()
        self._child.kill()
        failure = None if was_running else self._child.failure()
        if failure is not None:
            text = f"{failure.text}; the run went on without it"
            self._inbox.put(StatusMessage(VIEWER, "fault", {"text": text}))

    def kill(self) -> None:
        """End it at once."""
        self._child.kill()

    def _wait_for_start(self) -> None:
        give_up_s = time.monotonic() + _START_TIMEOUT_S
        while self._child.is_running() and time.monotonic() < give_up_s:
            if self._child.has_started.wait(_POLL_S):
                return
