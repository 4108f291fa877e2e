"""Command-line options of studies, and how they combine with a study's file."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import typer

from controller.laws import COMPARED_LAWS
from deploy.cli.common import parse_laws
from deploy.cli.options import (
    Confirm,
    GateOptions,
    InterfaceOption,
    Out,
    Overrides,
    Overwrite,
    RequireBounds,
    ScenarioArgument,
)
from deploy.scenario.interface_choice import (
    COMPENSATION,
    DRIVE_FEEDBACK,
    interface_values,
    laws_for,
)
from deploy.scenario.study_keys import LAW
from deploy.scenario.yaml_files import ScenarioError, option_value, parse_override, read_yaml
from deploy.study.comparison.settling import OFFSETS_RAD

_DEFAULT_LAWS = f"by default {', '.join(COMPARED_LAWS)}, and the scenario's"


@dataclass(kw_only=True)
class WorkerOptions:
    """The options of every command with many runs."""

    overrides: Overrides = None
    workers: Annotated[
        int | None, typer.Option(min=1, help="Number of processes; one per core by default.")
    ] = None
    scheduler: Annotated[
        str | None, typer.Option(metavar="ADDRESS", help="A Dask scheduler: tcp://host:8786.")
    ] = None
    out: Out = None
    overwrite: Overwrite = False

    def fixed(self) -> dict[str, Any]:
        """Return the values of ``--set`` by dotted key."""
        return dict(map(parse_override, self.overrides or []))


@dataclass(kw_only=True)
class CompareOptions(GateOptions, WorkerOptions):
    """The options of `compare`."""

    scenario: ScenarioArgument = "paper_arm"
    laws: Annotated[
        str | None, typer.Option(metavar="A,B,…", help=f"Laws to compare; {_DEFAULT_LAWS}.")
    ] = None
    settling: Annotated[
        bool,
        typer.Option("--settling", help="Also measure settling times from offsets of up to 1 rad."),
    ] = False
    require_bounds: RequireBounds = False
    confirm: Confirm = False

    def definition(self) -> dict[str, Any]:
        """Return the comparison that the options describe."""
        return {
            "scenario": self.scenario, "laws": parse_laws(self.laws), "set": self.fixed(),
            "settling_rad": list(OFFSETS_RAD) if self.settling else [],
            "confirm": self.confirm or None,
        }  # fmt: skip


@dataclass(kw_only=True)
class StudyOptions(WorkerOptions):
    """The options of studies that can draw uncertain plants."""

    plants: Annotated[
        int | None, typer.Option(metavar="N", help="Number of uncertain plants to draw.")
    ] = None
    plant_seed: Annotated[int | None, typer.Option(help="Seed of the drawn plants; default 1.")] = (
        None
    )
    uncertainty: Annotated[
        str | None, typer.Option(help="A file of ranges to draw from; shipped are full, half.")
    ] = None

    def definition(self) -> dict[str, Any]:
        """Return the given part of a study's definition, without values from ``--set``."""
        given = {
            "plants": self.plants, "plant_seed": self.plant_seed, "uncertainty": self.uncertainty,
        }  # fmt: skip
        return {key: value for key, value in given.items() if value is not None}


@dataclass(kw_only=True)
class ConfirmedStudyOptions(StudyOptions):
    """The options that `sweep` and `margin` have in common."""

    confirm: Confirm = False

    def definition(self) -> dict[str, Any]:
        return super().definition() | ({"confirm": True} if self.confirm else {})


@dataclass(kw_only=True)
class TuneOptions(StudyOptions):
    """The options of `tune`."""

    scenario: ScenarioArgument = "paper_arm"
    laws: Annotated[
        str | None,
        typer.Option(metavar="A,B,…", help="Laws to tune; by default those of compare."),
    ] = None
    goal: Annotated[
        str | None,
        typer.Option(
            "--for",
            metavar="rms|margin",
            help="rms: a small error with a smooth torque; margin: a large delay."
            r"  \[default: rms]",
        ),
    ] = None
    budget: Annotated[
        int | None, typer.Option(metavar="N", help="Candidates for each law; default 100.")
    ] = None
    search_seed: Annotated[int | None, typer.Option(help="Seed of the search; default 1.")] = None
    duration: Annotated[
        float | None, typer.Option(help="Longest run of the search in s; default 8.")
    ] = None
    delays: Annotated[
        str | None,
        typer.Option(metavar="A,B,…", help="Round trips in ms that --for margin tries."),
    ] = None
    travel_limit: Annotated[
        float | None,
        typer.Option(help="With --for rms: limit on a torque's travel, in its own limits per s."),
    ] = None
    ranges: Annotated[
        Path | None, typer.Option(help="A YAML file: least and largest value of gains, by name.")
    ] = None

    def definition(self) -> dict[str, Any]:
        given = {
            "laws": parse_laws(self.laws) or COMPARED_LAWS,
            "goal": self.goal, "budget": self.budget, "search_seed": self.search_seed,
            "duration_s": self.duration, "travel_limit_per_s": self.travel_limit,
            "delays_ms": listed("delays", self.delays),
            "ranges": None if self.ranges is None else read_yaml(self.ranges),
        }  # fmt: skip
        is_margin = self.goal == "margin"
        if is_margin and self.travel_limit is not None:
            raise ScenarioError("--travel-limit: must be left out with --for margin")
        if not is_margin and self.delays is not None:
            raise ScenarioError("--delays: must be left out unless --for margin is given")
        asked = super().definition() | {"scenario": self.scenario, "set": self.fixed()}
        return asked | {key: value for key, value in given.items() if value is not None}


@dataclass(kw_only=True)
class SweepOptions(GateOptions, ConfirmedStudyOptions):
    """The options of `sweep`."""

    sweep: Annotated[
        str, typer.Argument(metavar="SWEEP", help="A sweep file, or the name of a shipped one.")
    ]


@dataclass(kw_only=True)
class MarginOptions(GateOptions, ConfirmedStudyOptions):
    """The options of `margin`."""

    scenario: Annotated[
        list[str] | None,
        typer.Argument(help="Scenario files or shipped scenarios; default paper_arm."),
    ] = None
    laws: Annotated[
        str | None, typer.Option(metavar="A,B,…", help=f"Laws to test; {_DEFAULT_LAWS}.")
    ] = None
    compensation: Annotated[
        str | None, typer.Option(metavar="off,on", help="Delay compensation: off, on, or both.")
    ] = None
    drive_feedback: Annotated[
        str | None,
        typer.Option(metavar="off,on", help="A loop closed at the drives: off, on, or both."),
    ] = None
    running: Annotated[
        str | None,
        typer.Option(
            metavar="off,on", help="off: full size from the start; on: it grows from 1 s to 3 s."
        ),
    ] = None
    excitation: Annotated[
        bool | None,
        typer.Option(help="Push every joint of a running loop once: 1 % of its torque, 20 ms."),
    ] = None
    quantity: Annotated[
        str | None, typer.Option(help="delay (round trip), jitter, loss, or a scenario's key.")
    ] = None
    direction: Annotated[
        str | None, typer.Option(help="Direction of the delay: both, uplink or downlink.")
    ] = None
    seeds: Annotated[
        str | None,
        typer.Option("--seeds", metavar="N", help="Number of seeds, or a list such as [3, 5]."),
    ] = None
    offsets: Annotated[
        str | None, typer.Option(metavar="A,B,…", help="Factors on the initial offset.")
    ] = None
    duration: Annotated[
        float | None, typer.Option(help="Length of each run in s; the scenario's by default.")
    ] = None
    resolution: Annotated[float | None, typer.Option(help="Resolution of the margin.")] = None
    limit: Annotated[
        float | None, typer.Option(help="Largest value to try, in the quantity's unit.")
    ] = None
    pattern: Annotated[
        str | None,
        typer.Option(metavar="any", help="any: also the margin for every pattern of delays."),
    ] = None
    what_helps: Annotated[
        bool | None,
        typer.Option(
            help="Try remedies at the first failure; on unless --study, --plants or gate."
        ),
    ] = None
    smaller_rotors: Annotated[
        bool | None,
        typer.Option(help="Search again with a tenth of estimated rotors; on as --what-helps."),
    ] = None
    exhaustive: Annotated[
        bool | None,
        typer.Option(
            "--exhaustive",
            help="Make every run, to its end, also where fewer decide; default with --confirm.",
        ),
    ] = None
    values: Annotated[
        str | None, typer.Option(metavar="A,B,…", help="Values to try on every plant.")
    ] = None
    kept_share: Annotated[
        float | None,
        typer.Option(
            "--kept-share", help="Share of plants that must keep their bounds; default 0.95."
        ),
    ] = None
    study: Annotated[
        str | None, typer.Option(help="A study file, or the name of a shipped study.")
    ] = None
    interface: InterfaceOption = None

    def definition(self) -> dict[str, Any]:
        costly = (self.study, self.plants, self.at_least, self.baseline)
        given: dict[str, Any] = {
            **dict.fromkeys(_FOLLOW_UPS, True if all(each is None for each in costly) else None),
            "scenarios": self.scenario or None,
            "laws": parse_laws(self.laws) or laws_for(self.interface),
            "seeds": None if self.seeds is None else option_value("--seeds", self.seeds),
            "duration_s": self.duration,
        }
        as_given = {name: getattr(self, name) for name in _AS_GIVEN}
        given |= {name: value for name, value in as_given.items() if value is not None}
        given |= {name: listed(name, getattr(self, name)) for name in _LISTED}
        return super().definition() | {
            key: value for key, value in given.items() if value is not None
        }


_FOLLOW_UPS = ("what_helps", "smaller_rotors")
_LISTED = ("compensation", "drive_feedback", "running", "offsets", "values")
_AS_GIVEN = (
    "excitation", "quantity", "direction", "resolution", "limit", "kept_share", "pattern",
    "exhaustive", *_FOLLOW_UPS,
)  # fmt: skip
"""Options with the same name as in a study's file: lists of values, and single values."""


def definition_with(options: MarginOptions, values: dict[str, Any]) -> dict[str, Any]:
    """Return a study's definition, in which the given options take precedence.

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
    for_robot = interface_values(options.interface)
    varied = {"compensation": COMPENSATION, "drive_feedback": DRIVE_FEEDBACK}
    asked = {LAW, *(key for name, key in varied.items() if name in given)}
    own = own | {key: value for key, value in for_robot.items() if key not in asked}
    return values | given | {"set": {**own, **fixed}}


def listed(name: str, text: str | None) -> list[Any] | None:
    """Return the values in ``a,b,…``, with the types of YAML."""
    option = f"--{name.replace('_', '-')}"
    return None if text is None else [option_value(option, part) for part in text.split(",")]
