"""The command line: `funnel-hil`."""

from __future__ import annotations

import atexit
import gc
import logging
import sys
from collections import UserDict
from importlib import import_module
from typing import Any

import typer
from typer.core import TyperGroup

from deploy.cli.closed_output import outlive_readers
from deploy.exit_codes import BAD_INPUT, FAULT, INTERRUPTED
from deploy.scenario.yaml_files import InputError
from deploy.stop_signals import Stopped, stop_at_once

_COMMANDS = {
    "run": "deploy.cli.run:run",
    "simulate": "deploy.cli.run:simulate",
    "controller": "deploy.cli.processes:controller",
    "plant": "deploy.cli.processes:plant",
    "record": "deploy.cli.processes:record",
    "relay": "deploy.cli.processes:relay",
    "keys": "deploy.cli.keys:app",
    "compare": "deploy.cli.experiments:compare",
    "sweep": "deploy.cli.studies:sweep",
    "margin": "deploy.cli.studies:margin",
    "report": "deploy.cli.experiments:report",
    "replay": "deploy.cli.experiments:replay",
    "reference": "deploy.cli.reference:reference",
    "bench": "deploy.cli.experiments:bench",
    "drives": "deploy.cli.drives:drives",
    "doctor": "deploy.cli.doctor:doctor",
}
"""Where each command is: a function, or a group of commands."""

_NEW_OBJECTS = 20_000
"""The garbage collector looks after so many; Python's 700 make importing a third slower."""


class _Commands(UserDict[str, Any]):
    """Commands by name, each imported when it is asked for: a plant needs no figures."""

    def __getitem__(self, name: str) -> Any:
        if isinstance(self.data[name], str):
            self.data[name] = _imported(name, self.data[name])
        return self.data[name]


def _imported(name: str, place: str) -> Any:
    module, _, attribute = place.partition(":")
    found = getattr(import_module(module), attribute)
    if isinstance(found, typer.Typer):
        group = typer.main.get_command(found)
        group.name = name
        return group
    alone = typer.Typer(add_completion=False)
    alone.command(name)(found)
    return typer.main.get_command(alone)


class _LazyGroup(TyperGroup):
    def __init__(self, **attributes: Any) -> None:
        super().__init__(**attributes)
        self.commands = _Commands(_COMMANDS)


app = typer.Typer(
    cls=_LazyGroup, no_args_is_help=True, add_completion=False, pretty_exceptions_enable=False
)


@app.callback()
def funnel_hil() -> None:
    """Hardware-in-the-loop test bench for prescribed-performance robot control."""


def main() -> None:
    """Entry point; bad input and requests to stop end here, with one message and their code."""
    stop_at_once()
    outlive_readers()
    gc.set_threshold(_NEW_OBJECTS)
    atexit.register(gc.freeze)  # at the end the system takes all memory back without a search
    logging.basicConfig(level=logging.ERROR, format="%(message)s", stream=sys.stderr)
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
