"""The table of commands, each imported when it is called: help and errors need no physics."""

from __future__ import annotations

from importlib import import_module
from typing import Any

import typer
from typer.core import TyperCommand

from deploy.scenario.foreign_code import code_is_named

COMMANDS = {
    "run": (
        "deploy.cli.run:run",
        "Run controller, plant and recorder as separate processes, and judge the run.",
    ),
    "simulate": (
        "deploy.cli.run:simulate",
        "Run a scenario in one process and in virtual time.",
    ),
    "view": (
        "deploy.cli.view:view",
        "Show a run in the browser and in Foxglove: one under way, or a recorded one.",
    ),
    "controller": (
        "deploy.cli.processes:controller",
        "Be the controller: answer the joint states of a plant on the bus.",
    ),
    "plant": (
        "deploy.cli.processes:plant",
        "Be the plant: emulate the arm for a controller on the bus.",
    ),
    "record": (
        "deploy.cli.processes:record",
        "Be the recorder: write every message on the bus to a run folder.",
    ),
    "relay": (
        "deploy.cli.processes:relay",
        "Be a relay between two TCP peers: hold back every byte between controller and plant.",
    ),
    "keys": (
        "deploy.cli.keys:app",
        "Make, issue and list keys for link.security.",
    ),
    "compare": (
        "deploy.cli.study.experiments:compare",
        "Run a scenario under several laws in virtual time, and set their results side by side.",
    ),
    "sweep": (
        "deploy.cli.study.studies:sweep",
        "Run every point of a grid with every seed, on all cores or a Dask cluster.",
    ),
    "margin": (
        "deploy.cli.study.studies:margin",
        "Find the largest delay, or anything else, at which each law keeps its bounds.",
    ),
    "report": (
        "deploy.cli.study.experiments:report",
        "Judge what was recorded again: summary.json and report.html of what a folder holds.",
    ),
    "diff": (
        "deploy.cli.study.diff:diff",
        "Set recorded runs side by side: real time and lockstep, two laws, two versions.",
    ),
    "replay": (
        "deploy.cli.study.replay:replay",
        "Feed a recorded run to the law again and compare the torques bit for bit.",
    ),
    "reference": (
        "deploy.cli.interop.reference:reference",
        "Write where the joints are to be at each tick: position, velocity and acceleration.",
    ),
    "bench": (
        "deploy.cli.study.experiments:bench",
        "Measure what things cost on this machine, as ratios of medians side by side.",
    ),
    "drives": (
        "deploy.cli.drives:drives",
        "Be the arm's motor drives on a CAN bus, with physics behind them, for any driver code.",
    ),
    "robot": (
        "deploy.cli.robot:robot",
        "Show what is understood of an arm: its joints, limits, inertias, gains, and what is odd.",
    ),
    "doctor": (
        "deploy.cli.doctor:doctor",
        "Say what this machine grants, and what each missing thing costs; nothing is changed.",
    ),
    "scenarios": (
        "deploy.cli.shelf:scenarios",
        "List the scenarios and studies that are shipped.",
    ),
    "export": (
        "deploy.cli.interop.export:export",
        "Write a recorded run as tables over time: what is judged, and every topic.",
    ),
    "runs": (
        "deploy.cli.shelf:app",
        "Folders of results: list, tag, prune.",
    ),
    "ros-package": (
        "deploy.cli.interop.ros_package:ros_package",
        "Write our message types as a ROS 2 package, for colcon to build.",
    ),
    "ros2-control": (
        "deploy.cli.interop.ros2_control:ros2_control",
        "Write the arm's URDF with its ros2_control element, and a controllers.yaml for it.",
    ),
    "includes": (
        "deploy.cli.interop.includes:includes",
        "Print the C compiler's option for the header of controller.law: external.",
    ),
}
"""Where each command is, a function or a group of commands, and the first line of its help."""

LOOKING = {"view", "report", "diff", "reference", "robot", "export", "ros2-control"}
"""Commands that read scenarios and run nothing of what these name: no law, program or process."""


class LazyCommand(TyperCommand):
    """Stands for a command until it is called; knows but its name and the first line of its help.

    Args:
        name: of the command.
        place: ``module:attribute``.
        summary: first line of its help.
    """

    def __init__(self, name: str, place: str, summary: str) -> None:
        super().__init__(name, help=summary)
        self.place = place

    def make_context(self, *args: Any, **extra: Any) -> Any:
        """That of the command itself, which does all the rest.

        A command that only looks runs no code of the files it looks at; any other one says whose.
        """
        context = self.load().make_context(*args, **extra)
        if self.name in LOOKING:
            from controller.laws.custom import custom_laws_left_out  # as the command itself does

            context.with_resource(custom_laws_left_out())
        elif context.params.get("parent_pid") is None:
            context.with_resource(code_is_named())
        return context

    def load(self) -> Any:
        """The command itself."""
        module, _, attribute = self.place.partition(":")
        found = getattr(import_module(module), attribute)
        if isinstance(found, typer.Typer):
            group = typer.main.get_command(found)
            group.name = self.name
            return group
        alone = typer.Typer(add_completion=False)
        alone.command(self.name)(found)
        return typer.main.get_command(alone)
