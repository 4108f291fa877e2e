"""The command line of a controller that has joined the bus, and is ready when a test lets it be."""

from __future__ import annotations

import os
import time
from pathlib import Path
from unittest import mock

from controller.control_loop import ControlLoop
from deploy import cli


def main() -> None:
    """In the folder that GATE names, the file ``waits`` tells that it does; ``open`` lets it on."""
    warm_up, gate = ControlLoop.warm_up, Path(os.environ["GATE"])

    def slow(loop: ControlLoop) -> None:
        (gate / "waits").touch()
        while not (gate / "open").exists():
            time.sleep(0.01)
        warm_up(loop)

    with mock.patch.object(ControlLoop, "warm_up", slow):
        cli.main()
