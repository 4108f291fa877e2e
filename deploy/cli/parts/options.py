"""Options that commands share. Importing this module loads nothing heavy."""

from __future__ import annotations

import functools
import inspect
import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, TypeVar, get_type_hints

import typer

from bus_schema.foreign_text import say

Options = TypeVar("Options")


def taking(options: type[Options]) -> Callable[[Callable[[Options], None]], Callable[..., None]]:
    """Make each field of a dataclass a command-line option, and call the command with it."""

    def decorated(command: Callable[[Options], None]) -> Callable[..., None]:
        @functools.wraps(command)
        def with_options(**given: Any) -> None:
            command(options(**given))

        hints, signature = get_type_hints(options, include_extras=True), inspect.signature(options)
        parameters = [each.replace(annotation=hints[name])
                      for name, each in signature.parameters.items()]  # fmt: skip
        vars(with_options)["__signature__"] = signature.replace(parameters=parameters)
        return with_options

    return decorated


def _newest(overrides: list[str] | None) -> list[str] | None:
    """Keep the last ``--set`` of each key, so that scripts can append their own."""
    keys = [text.partition("=")[0] for text in overrides or []]
    if overrides is None or len(set(keys)) == len(keys):
        return overrides
    from deploy.scenario.yaml_files import parse_override  # heavy

    last = {parse_override(text)[0]: place for place, text in enumerate(overrides)}
    for place, text in enumerate(overrides):
        if place != last[keys[place]]:
            say(f"--set {text}: replaced by a later --set", err=True)
    return [text for place, text in enumerate(overrides) if place in last.values()]


def finite(number: float | None) -> float | None:
    """Refuse inf, and NaN, which is in any range."""
    if number is not None and not math.isfinite(number):
        raise typer.BadParameter(f"{number} is not finite.")
    return number


ScenarioArgument = Annotated[
    str, typer.Argument(help="A scenario file, or the name of a shipped scenario.")
]
JointsOption = Annotated[
    str | None, typer.Option(metavar="A,B,…", help="Drive these joints, and hold all others.")
]
IncludeOption = Annotated[
    list[Path] | None,
    typer.Option(
        metavar="FOLDER", help="Folder with packages that the file refers to; repeatable."
    ),
]
MassOption = Annotated[
    float | None,
    typer.Option(metavar="KG", help="Mass of the whole arm, if its file gives no inertias."),
]
NetworkOption = Annotated[
    str | None,
    typer.Option(
        metavar="LOG",
        help="A trace or its name, output of ping or iperf3 --json, or a table of delays.",
    ),
]
Overrides = Annotated[
    list[str] | None,
    typer.Option(
        "--set",
        metavar="KEY=VALUE",
        help="Override a scenario value; repeatable.",
        callback=_newest,
    ),
]
InterfaceOption = Annotated[
    str | None,
    typer.Option(
        metavar="KIND",
        help="Interface of the robot: servoj, franka_torque, …; see plant.interface.kind.",
    ),
]
Out = Annotated[
    Path | None, typer.Option("--out", help="Folder for the results.", show_default=False)
]
Overwrite = Annotated[bool, typer.Option("--overwrite", help="Remove the results in --out first.")]
NoReport = Annotated[
    bool,
    typer.Option("--no-report", help="Write no report.html; funnel-hil report writes it later."),
]
RequireBounds = Annotated[
    bool, typer.Option("--require-bounds", help="Exit with 3 if an error left the funnel.")
]
Confirm = Annotated[
    bool,
    typer.Option(
        "--confirm",
        help="Repeat every run on the other physics engine and with Runge-Kutta, and compare the"
        " verdicts.",
    ),
]


@dataclass
class OneRunOptions:
    """The options that `run` and `simulate` have in common."""

    scenario: ScenarioArgument = "paper_arm"
    overrides: Overrides = None
    out: Out = None
    overwrite: Overwrite = False
    require_bounds: RequireBounds = False
    no_report: NoReport = False


@dataclass(kw_only=True)
class GateOptions:
    """Thresholds on the margin, and files for a CI service."""

    at_least: Annotated[
        str | None,
        typer.Option(
            metavar="N",
            help="Exit with 3 if a result is smaller: of margin, a value such as 20ms; of simulate,"
            " compare and sweep, the distance to the bound, such as 15%. With a length or time, as"
            " 2mm, exit with 3 if the tip's largest error or a joint's lag is larger.",
        ),
    ] = None
    baseline: Annotated[
        Path | None, typer.Option(help="Exit with 3 if a margin is smaller than in this result.")
    ] = None
    tolerance: Annotated[
        str | None,
        typer.Option(
            metavar="N",
            help="How much smaller than --baseline a margin may be, such as 1ms, or 20% of the"
            " earlier value.",
        ),
    ] = None
    allow_changes: Annotated[
        bool,
        typer.Option(
            "--allow-changes", help="List how the test of --baseline differs, instead of exit 2."
        ),
    ] = False
    junit: Annotated[Path | None, typer.Option(help="Write a JUnit XML file.")] = None
    markdown: Annotated[Path | None, typer.Option(help="Write a Markdown table.")] = None
    history: Annotated[
        Path | None, typer.Option(help="Append the result in this folder, plot it over commits.")
    ] = None


@dataclass
class SimulateOptions(OneRunOptions, GateOptions):
    """The options of `simulate`."""

    confirm: Confirm = False


@dataclass
class RunOptions(OneRunOptions):
    """The options of `run`."""

    real_delay_ms: Annotated[
        float | None,
        typer.Option(
            "--real-delay",
            metavar="MS",
            help="Delay every byte by a relay between controller and plant. MS is the round trip,"
            " half of it in each direction.",
        ),
    ] = None
    await_controller: Annotated[
        bool,
        typer.Option(
            "--await-controller",
            help="Start only plant and recorder, and wait up to link.connect_timeout_s for a"
            " controller that you start, at the endpoints of the scenario.",
        ),
    ] = False
    live: Annotated[
        bool,
        typer.Option("--live", help="Show the run live in the browser and in Foxglove."),
    ] = False
    confirm: Annotated[
        bool,
        typer.Option(
            "--confirm",
            help="With clock=lockstep: repeat the run in one process. A different digest or"
            " verdict is a fault.",
        ),
    ] = False
