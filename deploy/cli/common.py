"""What the commands of the command line share: exit codes, options, interrupts."""

from __future__ import annotations

import signal
from collections.abc import Callable
from pathlib import Path
from types import FrameType
from typing import Annotated

import typer

FINISHED, FAULT, BAD_INPUT, BOUNDS_NOT_KEPT, INTERRUPTED = 0, 1, 2, 3, 130
"""Exit codes."""

ScenarioArgument = Annotated[
    str, typer.Argument(help="A scenario file, or the name of a shipped scenario.")
]
Overrides = Annotated[
    list[str] | None,
    typer.Option("--set", metavar="KEY=VALUE", help="Override a scenario value; repeatable."),
]
Out = Annotated[
    Path | None, typer.Option("--out", help="Folder for the results.", show_default=False)
]
RequireBounds = Annotated[
    bool, typer.Option("--require-bounds", help="Exit with 3 if an error left the funnel.")
]


def on_interrupt(stop: Callable[[], None]) -> None:
    """Call `stop` when the user or the system wants an end."""

    def handle(_number: int, _frame: FrameType | None) -> None:
        stop()

    signal.signal(signal.SIGINT, handle)
    signal.signal(signal.SIGTERM, handle)
