"""The options of studies on the command line, and what they say beside a study's file."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Any

import typer

from deploy.cli.common import parse_laws
from deploy.cli.options import (
    Confirm,
    GateOptions,
    Out,
    Overrides,
    Overwrite,
    RequireBounds,
    ScenarioArgument,
)
from deploy.scenario.yaml_files import ScenarioError, option_value, parse_override
from deploy.study.comparison.settling import OFFSETS_RAD


@dataclass(kw_only=True)
class WorkerOptions(GateOptions):
    """The options of every command that does many runs."""

    overrides: Overrides = None
    workers: Annotated[
        int | None, typer.Option(min=1, help="Processes to run on; one per core by default.")
    ] = None
    scheduler: Annotated[
        str | None, typer.Option(metavar="ADDRESS", help="A Dask scheduler: tcp://host:8786.")
    ] = None
    out: Out = None
    overwrite: Overwrite = False
    confirm: Confirm = False

    def fixed(self) -> dict[str, Any]:
        """What ``--set`` gives, by dotted key."""
        return dict(map(parse_override, self.overrides or []))


@dataclass(kw_only=True)
class CompareOptions(WorkerOptions):
    """The options of `compare`."""

    scenario: ScenarioArgument = "paper_arm"
    laws: Annotated[
        str | None, typer.Option(metavar="A,B,…", help="Laws to compare; all by default.")
    ] = None
    settling: Annotated[
        bool,
        typer.Option("--settling", help="Also measure settling times from offsets of up to 1 rad."),
    ] = False
    require_bounds: RequireBounds = False

    def definition(self) -> dict[str, Any]:
        """The comparison that is asked for."""
        return {
            "scenario": self.scenario, "laws": parse_laws(self.laws), "set": self.fixed(),
            "settling_rad": list(OFFSETS_RAD) if self.settling else [],
            "confirm": self.confirm or None,
        }  # fmt: skip


@dataclass(kw_only=True)
class StudyOptions(WorkerOptions):
    """The options that `sweep` and `margin` have in common."""

    plants: Annotated[
        int | None, typer.Option(metavar="N", help="Try N plants, drawn from what is uncertain.")
    ] = None
    plant_seed: Annotated[
        int | None, typer.Option(help="Another one draws other plants; default 1.")
    ] = None
    uncertainty: Annotated[
        str | None, typer.Option(help="A file of ranges to draw from; shipped are full, half.")
    ] = None

    def definition(self) -> dict[str, Any]:
        """What is given of a study's definition, but for what ``--set`` gives."""
        given = {
            "plants": self.plants, "plant_seed": self.plant_seed, "uncertainty": self.uncertainty,
            "confirm": self.confirm or None,
        }  # fmt: skip
        return {key: value for key, value in given.items() if value is not None}


@dataclass(kw_only=True)
class SweepOptions(StudyOptions):
    """The options of `sweep`."""

    sweep: Annotated[
        str, typer.Argument(metavar="SWEEP", help="A sweep file, or the name of a shipped one.")
    ]


@dataclass(kw_only=True)
class MarginOptions(StudyOptions):
    """The options of `margin`."""

    scenario: Annotated[
        list[str] | None,
        typer.Argument(help="Scenario files or names of shipped ones; default paper_arm."),
    ] = None
    laws: Annotated[str | None, typer.Option(metavar="A,B,…", help="Laws; all by default.")] = None
    compensation: Annotated[
        str | None, typer.Option(metavar="off,on", help="Delay compensation off, on, both.")
    ] = None
    drive_feedback: Annotated[
        str | None, typer.Option(metavar="off,on", help="Feedback at the drives likewise.")
    ] = None
    running: Annotated[
        str | None, typer.Option(metavar="off,on", help="From the start; ramped up, 1 s to 3 s.")
    ] = None
    quantity: Annotated[
        str | None, typer.Option(help="delay (round trip), jitter, loss, or a scenario's key.")
    ] = None
    direction: Annotated[
        str | None, typer.Option(help="Of the link: both, uplink or downlink.")
    ] = None
    seeds: Annotated[
        str | None, typer.Option("--seeds", metavar="N", help="How many, or a list [3, 5].")
    ] = None
    offsets: Annotated[
        str | None, typer.Option(metavar="A,B,…", help="Factors on the initial offset.")
    ] = None
    duration: Annotated[
        float | None, typer.Option(help="Length of each run, s; the scenario's own.")
    ] = None
    resolution: Annotated[float | None, typer.Option(help="To which the margin is found.")] = None
    limit: Annotated[
        float | None, typer.Option(help="The last value tried, in the quantity's unit.")
    ] = None
    values: Annotated[
        str | None, typer.Option(metavar="A,B,…", help="Values to try on all plants.")
    ] = None
    kept_share: Annotated[
        float | None, typer.Option("--kept-share", help="Plants to be kept; default 0.95.")
    ] = None
    study: Annotated[
        str | None, typer.Option(help="A file with all of this, or the name of a shipped one.")
    ] = None

    def definition(self) -> dict[str, Any]:
        given: dict[str, Any] = {
            "scenarios": self.scenario or None,
            "laws": parse_laws(self.laws),
            "seeds": None if self.seeds is None else option_value("--seeds", self.seeds),
            "duration_s": self.duration,
        }
        given |= {name: getattr(self, name) for name in _AS_GIVEN}
        given |= {name: _listed(name, getattr(self, name)) for name in _LISTED}
        return super().definition() | {
            key: value for key, value in given.items() if value is not None
        }


_LISTED = ("compensation", "drive_feedback", "running", "offsets", "values")
_AS_GIVEN = ("quantity", "direction", "resolution", "limit", "kept_share")
"""Options that are called as a study's file has them: lists of values, and others."""


def definition_with(options: MarginOptions, values: dict[str, Any]) -> dict[str, Any]:
    """A study's definition with the options that are given beside it, which take precedence.

    Raises:
        ScenarioError: options contradict each other.
    """
    given, fixed = options.definition(), options.fixed()
    if options.duration is not None and "duration_s" in fixed:
        raise ScenarioError("--duration and --set duration_s: must not be given together")
    own = values.get("set") or {}
    if not isinstance(own, dict):
        return values  # which the schema refuses, with the reason
    if options.duration is not None:
        own = {key: value for key, value in own.items() if key != "duration_s"}
    if "duration_s" in fixed:
        values = {key: value for key, value in values.items() if key != "duration_s"}
    return values | given | {"set": {**own, **fixed}}


def _listed(name: str, text: str | None) -> list[Any] | None:
    """Values from ``a,b,…``, typed as YAML has them."""
    option = f"--{name.replace('_', '-')}"
    return None if text is None else [option_value(option, part) for part in text.split(",")]
