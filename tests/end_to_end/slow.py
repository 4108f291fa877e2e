"""The command line of a controller that takes its time between joining the bus and being ready."""

from __future__ import annotations

import time
from unittest import mock

from controller.control_loop import ControlLoop
from deploy import cli

_SLOW_S = 2.0


def main() -> None:
    warm_up = ControlLoop.warm_up

    def slow(loop: ControlLoop) -> None:
        time.sleep(_SLOW_S)
        warm_up(loop)

    with mock.patch.object(ControlLoop, "warm_up", slow):
        cli.main()
