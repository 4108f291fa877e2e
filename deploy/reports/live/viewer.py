"""The viewer: takes snapshots of a run from a source, and serves them to browsers and Foxglove."""

from __future__ import annotations

import contextlib
import os
import time
from collections.abc import Callable
from importlib.util import find_spec
from typing import Any, Protocol

from bus_schema.errors import needs_extra
from deploy.reports.live.figures import WINDOW_S, live_figures
from deploy.reports.live.foxglove_layout import foxglove_layout
from deploy.reports.live.frames import Frames, RunState
from deploy.reports.live.page_server import PageServer
from deploy.run.network.snapshot import Snapshot
from deploy.scenario.setup import Setup

_FRAME_S = 0.05
_WAIT_S = 0.1
_NICENESS = 10
_END_NOTICE_S = 0.3
"""Time for browsers to receive the end of the run."""


class Source(Protocol):
    """Source of a run's snapshots."""

    def receive(self, timeout_s: float) -> Snapshot | None:
        """Return the next snapshot; None if none arrives in time."""

    def close(self) -> None:
        """Close all that is open."""


class Viewer:
    """Server of a run.

    Args:
        setup: the scenario.
        source_name: name of the source, for the page.
        port: port of the page; 0 for any.
        foxglove_port: port of Foxglove's server; None for its default, or any if that is taken.

    Attributes:
        frames: frames for the page.
        page: server of the page.

    Raises:
        OSError: a port is taken.
    """

    def __init__(
        self, setup: Setup, source_name: str, *, port: int = 0, foxglove_port: int | None = None
    ) -> None:
        self._state, self.frames = RunState(setup), Frames()
        run = {
            "name": setup.scenario.name,
            "law": setup.scenario.controller.name,
            "source": source_name,
            "joints": list(setup.robot.joint_names),
            "duration_s": setup.scenario.duration_s,
            "window_s": WINDOW_S,
        }
        documents = {
            "/figures.json": live_figures(setup),
            "/run.json": run,
            "/foxglove_layout.json": foxglove_layout(setup),
        }
        self._foxglove = _foxglove(setup, foxglove_port)
        self.page = PageServer(self.frames, documents, port)
        self.page.start()
        self._has_news, self._frame_due_s = False, 0.0

    @property
    def is_watched(self) -> bool:
        """Whether a viewer has been opened."""
        foxglove = self._foxglove is not None and self._foxglove.is_watched
        return self.page.is_watched.is_set() or foxglove

    def places(self) -> str:
        """Return the addresses of the views, a line each."""
        if self._foxglove is None:
            return f"live view: {self.page.url}\nFoxglove:  {needs_extra('foxglove-sdk', 'live')}"
        return f"live view: {self.page.url}\nFoxglove:  {self._foxglove.url}"

    def run(self, source: Source, is_over: Callable[[], bool]) -> None:
        """Serve snapshots until the run is over."""
        while not is_over():
            snapshot = source.receive(_WAIT_S)
            if snapshot is not None:
                self._take(snapshot)
            if time.monotonic() >= self._frame_due_s:
                self._show()
        self._show()
        self.frames.end()
        time.sleep(_END_NOTICE_S)

    def close(self) -> None:
        """Stop serving."""
        self.page.shutdown()
        self.page.server_close()
        if self._foxglove is not None:
            self._foxglove.close()

    def _take(self, snapshot: Snapshot) -> None:
        self._state.take(snapshot)
        self._has_news = True
        if self._foxglove is not None:
            self._foxglove.publish(snapshot)

    def _show(self) -> None:
        """Add a frame, if there is anything new."""
        if not self._has_news:
            return
        self._has_news, self._frame_due_s = False, time.monotonic() + _FRAME_S
        frame = self._state.frame()
        if frame is not None:
            self.frames.add(frame)


def stand_back() -> None:
    """Lower this process's priority: a late viewer only shows less."""
    with contextlib.suppress(OSError):
        os.nice(_NICENESS)


def _foxglove(setup: Setup, port: int | None) -> Any:
    """Return Foxglove's server; None if its extra is not installed."""
    if find_spec("foxglove") is None:
        return None
    from deploy.reports.live.foxglove_server import FoxgloveServer

    return FoxgloveServer(setup, port)
