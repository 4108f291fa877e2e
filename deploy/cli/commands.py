"""The program `funnel-hil`: its commands and exit codes.

A command is imported when it is called, so that help and errors load no physics.
"""

from __future__ import annotations

import ast
import atexit
import gc
import logging
import os
import sys
from importlib import import_module
from importlib.metadata import version
from pathlib import Path
from typing import Annotated, Any

import typer
from typer.core import TyperCommand, TyperGroup

from bus_schema.foreign_text import printable
from bus_schema.runtime.extensions import installed
from deploy.reports.shipped_kinds import COMMANDS as OF_KINDS
from deploy.run.closed_output import outlive_readers
from deploy.run.exit_codes import with_exit_codes
from deploy.run.stop_signals import stop_at_once
from deploy.scenario.checking.foreign_code import code_is_named
from deploy.scenario.xacro_arguments import join_arguments

PANELS = {
    "Try": {
        "robot": "cli.robot:robot",
        "simulate": "cli.run:simulate",
        "run": "cli.run:run",
        "view": "cli.view:view",
        "scenarios": "cli.runs:scenarios",
        "doctor": "cli.doctor:doctor",
    },
    "Answer": {
        **{name: f"studies.{kind}.command:{name}" for kind, name in OF_KINDS.items()},
        "identify": "studies.identify.command:identify",
    },
    "Results": {
        "report": "cli.recorded:report",
        "diff": "studies.diff.command:diff",
        "export": "cli.export:export",
        "replay": "cli.recorded:replay",
        "runs": "cli.runs:app",
    },
    "Network": {
        "link": "cli.network.link:link",
        "trace": "cli.network.trace:app",
        "latency": "cli.network.latency:latency",
        "relay": "cli.processes:relay",
    },
    "Processes": {
        "plant": "cli.processes:plant",
        "controller": "cli.processes:controller",
        "record": "cli.processes:record",
        "drives": "cli.drives:drives",
        "robot-server": "cli.robot_server:robot_server",
        "keys": "cli.network.keys:app",
    },
    "Other systems": {
        "ros2": "cli.ros2:app",
        "reference": "cli.export:reference",
        "bench": "studies.bench.command:bench",
    },
}
"""Place of each command below `deploy`, ``module:function`` or ``module:app`` for a group, by the
panel of the help."""
EARLIER = {
    "ros-package": "cli.ros2:ros_package",
    "ros2-control": "cli.ros2:ros2_control",
    "includes": "cli.doctor:includes",
}
"""Earlier names of commands, which go on working and are not in the help."""
COMMANDS = {name: place for panel in PANELS.values() for name, place in panel.items()} | EARLIER

LOOKING = {
    "view", "report", "diff", "reference", "robot", "export", "identify", "ros2", "ros2-control",
}  # fmt: skip
"""Commands that only read: they run no law, program or process that a scenario names."""

_INSTEAD = {
    "--quick": ("--offsets", "--duration 6 --offsets 1"),
    "--network": ("--set", "--set link.uplink.trace.file=LOG --set link.downlink.trace.file=LOG"),
    "--interface": ("--set", "--set plant.interface.kind=KIND"),
    "--duration": ("--set", "--set duration_s=S"),
    "--seed": ("--set", "--set seed=N"),
    "--law": ("--set", "--set controller.law=NAME"),
    "--laws": ("--set", "--set controller.law=NAME"),
}
"""Options of other commands: what does the same in commands that have another option."""

_NEW_OBJECTS = 200_000
"""The garbage collector runs after this many new objects, more than the imports create. Python's
default of 700 slows them down by a third, 20 000 by a sixth."""


class LazyGroup(TyperGroup):
    """All commands by name. A command is imported when it is called."""

    def __init__(self, **attributes: Any) -> None:
        super().__init__(**attributes)
        panels = {name: panel for panel, names in PANELS.items() for name in names}
        self.commands = {
            name: LazyCommand(name, rich_help_panel=panels.get(name), hidden=name in EARLIER)
            for name in COMMANDS
        }

    def list_commands(self, ctx: Any) -> list[str]:
        """Return all names, also those of installed packages."""
        return [*super().list_commands(ctx), *_added()]

    def get_command(self, ctx: Any, name: str) -> Any:
        """Return a command; packages are looked up only for names that do not ship."""
        found = super().get_command(ctx, name)
        return (
            LazyCommand(name, rich_help_panel="Answer", help=_added().get(name))
            if (found is None and name in _added())
            else found
        )

    def format_help(self, *args: Any) -> None:
        for name, command in self.commands.items():
            command.help = summary_of(name)
        super().format_help(*args)


def _added() -> dict[str, str]:
    """Return what installed packages add, by name of the command: a kind of study each."""
    added = installed().get("studies", {})
    return {
        name: f"Run a study of {each[0].distribution}." for name, each in added.items()
        if name not in COMMANDS
    }  # fmt: skip


class LazyCommand(TyperCommand):
    """Stands for a command until it is called.

    Args:
        name: in `COMMANDS`.
    """

    def make_context(self, info_name: str | None, args: list[str], *more: Any, **extra: Any) -> Any:
        """Load the command and return its context.

        A command in `LOOKING` runs no code from the files it reads. Any other names that code.
        """
        command = self.load()
        try:
            context = command.make_context(info_name, join_arguments(args), *more, **extra)
        except Exception as error:
            _add_hint(error, {name for each in command.params for name in each.opts})
            raise
        if self.name in LOOKING:
            from controller.laws.custom import custom_laws_left_out  # as the command itself does

            context.with_resource(custom_laws_left_out())
        else:
            context.with_resource(code_is_named())
        return context

    def load(self) -> Any:
        """Import the command."""
        name = self.name or ""
        if name in _added():
            found = import_module("deploy.cli.parts.file_command").command_of(name)
        else:
            module, _, attribute = COMMANDS[name].partition(":")
            found = getattr(import_module(f"deploy.{module}"), attribute)
        if isinstance(found, typer.Typer):
            group = typer.main.get_command(found)
            group.name = self.name
            return group
        alone = typer.Typer(add_completion=False)
        alone.command(self.name)(found)
        return typer.main.get_command(alone)


def _add_hint(error: Any, options: set[str]) -> None:
    """Name the options of a command that do what an unknown one does elsewhere."""
    asked = getattr(error, "option_name", "")
    needed, instead = _INSTEAD.get(asked, ("", ""))
    if needed in options and not {f"{asked}s", asked.removesuffix("s")} & options:
        error.message, error.possibilities = f"{error.message}; use {instead}", None


def summary_of(name: str) -> str:
    """Read the first paragraph of a command's help from its source, without importing it."""
    module, _, attribute = COMMANDS[name].partition(":")
    file = Path(__file__).parents[1].joinpath(*module.split(".")).with_suffix(".py")
    tree = ast.parse(file.read_text(encoding="utf-8"))
    functions = {node.name: node for node in tree.body if isinstance(node, ast.FunctionDef)}
    text = ast.get_docstring(functions.get(attribute, tree)) or ""
    return " ".join(text.partition("\n\n")[0].split())


app = typer.Typer(
    cls=LazyGroup, no_args_is_help=True, add_completion=False, pretty_exceptions_enable=False
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
    """How much delay can your robot arm take?

    A test bench for robot control over networks and CAN: simulated arms, real processes.
    """  # noqa: D400


class LogLines(logging.Handler):
    """Log handler that looks up `sys.stderr` for each line.

    A live line replaces `sys.stderr` on a terminal, so that log lines appear above it.
    """

    def emit(self, record: logging.LogRecord) -> None:
        sys.stderr.write(f"{printable(self.format(record))}\n")
        sys.stderr.flush()


def main() -> None:
    """Run the command. Bad input and requests to stop end it with one message and an exit code."""
    stop_at_once()
    outlive_readers()
    for size in ("COLUMNS", "LINES"):
        if not os.environ.get(size, "1").strip("0"):  # a terminal of size 0 would show nothing
            del os.environ[size]
    gc.set_threshold(_NEW_OBJECTS)
    atexit.register(gc.freeze)  # skips the last collection: the system frees all memory anyway
    logging.basicConfig(level=logging.ERROR, format="%(message)s", handlers=[LogLines()])
    logging.getLogger("bus_schema").setLevel(logging.WARNING)
    logging.getLogger("plant_emulator").setLevel(logging.CRITICAL)
    with with_exit_codes():
        app()
