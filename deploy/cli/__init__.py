"""The command line: `funnel-hil`."""

from __future__ import annotations

import atexit
import gc
import logging
import sys
from importlib.metadata import version
from typing import Annotated, Any

import typer
from typer.core import TyperGroup

from bus_schema.errors import Stopped
from deploy.cli.commands import COMMANDS, LazyCommand
from deploy.cli.terminal.closed_output import outlive_readers
from deploy.cli.terminal.log_lines import LogLines
from deploy.exit_codes import BAD_INPUT, FAULT, INTERRUPTED
from deploy.input_error import InputError
from deploy.stop_signals import stop_at_once

_NEW_OBJECTS = 200_000
"""The garbage collector looks after so many, which is more than importing makes: Python's 700 make
that a third slower, and 20 000 a sixth."""


class _LazyGroup(TyperGroup):
    def __init__(self, **attributes: Any) -> None:
        super().__init__(**attributes)
        self.commands = {name: LazyCommand(name, *entry) for name, entry in COMMANDS.items()}


app = typer.Typer(
    cls=_LazyGroup, no_args_is_help=True, add_completion=False, pretty_exceptions_enable=False
)


def _show_version(asked: bool) -> None:
    if asked:
        print(f"funnel-hil {version('funnel-hil')}")
        raise typer.Exit


@app.callback()
def funnel_hil(
    _version: Annotated[
        bool,
        typer.Option("--version", callback=_show_version, is_eager=True, help="Show the version."),
    ] = False,
) -> None:
    """Hardware-in-the-loop test bench for prescribed-performance robot control."""


def main() -> None:
    """Entry point; bad input and requests to stop end here, with one message and their code."""
    stop_at_once()
    outlive_readers()
    gc.set_threshold(_NEW_OBJECTS)
    atexit.register(gc.freeze)  # at the end the system takes all memory back without a search
    logging.basicConfig(level=logging.ERROR, format="%(message)s", handlers=[LogLines()])
    logging.getLogger("bus_schema").setLevel(logging.WARNING)
    logging.getLogger("plant_emulator").setLevel(logging.CRITICAL)
    try:
        app()
    except InputError as error:
        print(f"error: {error}", file=sys.stderr)
        sys.exit(BAD_INPUT)
    except Stopped:
        print("stopped", file=sys.stderr)
        sys.exit(INTERRUPTED)
    except OSError as error:  # a disk that is full or gone
        print(f"error: {error}", file=sys.stderr)
        sys.exit(FAULT)
