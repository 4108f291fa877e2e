"""Options that commands share; to know them imports nothing heavy."""

from __future__ import annotations

import functools
import inspect
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, TypeVar, get_type_hints

import typer

Options = TypeVar("Options")


def taking(options: type[Options]) -> Callable[[Callable[[Options], None]], Callable[..., None]]:
    """Have a command line fill the fields of a dataclass, with which the command is called."""

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
    """What ``--set`` gives, of each key the last, so that scripts can add theirs."""
    keys = [text.partition("=")[0] for text in overrides or []]
    if overrides is None or len(set(keys)) == len(keys):
        return overrides
    from deploy.scenario.yaml_files import parse_override  # heavy

    last = {parse_override(text)[0]: place for place, text in enumerate(overrides)}
    for place, text in enumerate(overrides):
        if place != last[keys[place]]:
            typer.echo(f"--set {text}: a later --set takes its place", err=True)
    return [text for place, text in enumerate(overrides) if place in last.values()]


ScenarioArgument = Annotated[
    str, typer.Argument(help="A scenario file, or the name of a shipped scenario.")
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
Out = Annotated[
    Path | None, typer.Option("--out", help="Folder for the results.", show_default=False)
]
Overwrite = Annotated[
    bool, typer.Option("--overwrite", help="Replace the results that --out holds.")
]
NoReport = Annotated[
    bool, typer.Option("--no-report", help="Draw no report.html; funnel-hil report does it later.")
]
RequireBounds = Annotated[
    bool, typer.Option("--require-bounds", help="Exit with 3 if an error left the funnel.")
]
Confirm = Annotated[
    bool,
    typer.Option(
        "--confirm",
        help="Simulate every run on the other physics engine and by Runge-Kutta too, and say where"
        " verdicts agree.",
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
    """What a result must reach, and where a CI service finds the answer."""

    at_least: Annotated[
        str | None,
        typer.Option(
            metavar="N",
            help="Exit with 3 if a margin is smaller: 20ms, or 15% of the"
            " bound for simulate, compare and sweep.",
        ),
    ] = None
    baseline: Annotated[
        Path | None, typer.Option(help="Exit with 3 if a margin fell since this result.")
    ] = None
    tolerance: Annotated[
        str | None, typer.Option(metavar="N", help="Let it fall by so much since --baseline.")
    ] = None
    junit: Annotated[Path | None, typer.Option(help="Write a JUnit XML file.")] = None
    markdown: Annotated[Path | None, typer.Option(help="Write a Markdown table.")] = None
    history: Annotated[
        Path | None, typer.Option(help="Add the result to a history; draw it over commits.")
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
            help="Have a relay between controller and plant hold every byte back: the round trip,"
            " half of it each way.",
        ),
    ] = None
    await_controller: Annotated[
        bool,
        typer.Option(
            "--await-controller",
            help="Start plant and recorder only, and wait for a controller that is started"
            " elsewhere: for link.connect_timeout_s, at the endpoints of the scenario.",
        ),
    ] = False
    live: Annotated[
        bool,
        typer.Option(
            "--live", help="Show the run in the browser and in Foxglove while it happens."
        ),
    ] = False
    confirm: Annotated[
        bool,
        typer.Option(
            "--confirm",
            help="With clock=lockstep: simulate the run again in one process; another digest or"
            " verdict is a fault.",
        ),
    ] = False
