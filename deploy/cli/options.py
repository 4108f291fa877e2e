"""Options that commands share; to know them imports nothing heavy."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import typer


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
    bool,
    typer.Option("--no-report", help="Draw no report.html; funnel-hil report does it later."),
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


@dataclass(frozen=True)
class RunOptions:
    """What a run is asked for by options that `run` and `simulate` have in common.

    Attributes:
        scenario: file or name.
        overrides: ``KEY=VALUE``, each key once.
        out: folder for the results; None for one with name and time.
        overwrite: replace what it holds.
        require_bounds: an error that left the funnel has an exit code of its own.
        draws_report: draw a report.
        confirms: simulate it on other physics too.
    """

    scenario: str
    overrides: list[str]
    out: Path | None
    overwrite: bool
    require_bounds: bool
    draws_report: bool
    confirms: bool = False
