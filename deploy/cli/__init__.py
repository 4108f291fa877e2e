"""The command line: `funnel-hil`."""

from __future__ import annotations

import os
import signal
from types import FrameType
from typing import NoReturn


def program() -> None:
    """Entry point. The next file or pipe would get the number and output of a closed stream."""
    while (spare := os.open(os.devnull, os.O_RDWR)) <= 2:
        pass
    os.close(spare)
    main()


def main() -> None:
    """Run the command. A request to stop while the program loads ends it like any other."""
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        if signal.getsignal(number) != signal.SIG_IGN:
            signal.signal(number, _stop_loading)
    # Matrices are small: threads of a BLAS that wait for each other cost a verdict a second of CPU
    # time, and more beside other work. NumPy reads it when it is loaded; processes inherit it.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    from deploy.cli.commands import main  # takes a quarter of a second

    main()


def _stop_loading(_number: int, _frame: FrameType | None) -> NoReturn:
    os.write(2, b"stopped\n")
    os._exit(130)
