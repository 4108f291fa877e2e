"""Command-line options of studies, and how they combine with a study's file."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import typer

from deploy.cli.parts.common import parse_laws
from deploy.cli.parts.options import GateOptions, InterfaceOption, taking
from deploy.cli.parts.study_command import run_study
from deploy.cli.parts.study_options import DEFAULT_LAWS, ConfirmedStudyOptions, listed
from deploy.scenario.interface_choice import (
    COMPENSATION,
    DRIVE_FEEDBACK,
    interface_values,
    laws_for,
)
from deploy.scenario.study_keys import LAW
from deploy.scenario.yaml_files import ScenarioError, find_yaml, option_value
from deploy.studies.margin.margin_study import margin_study
from deploy.study.definition import SHIPPED, definition_in, is_sweep


@dataclass(kw_only=True)
class MarginOptions(GateOptions, ConfirmedStudyOptions):
    """The options of `margin`."""

    scenario: Annotated[
        list[str] | None,
        typer.Argument(help="Scenario files or shipped scenarios; default paper_arm."),
    ] = None
    laws: Annotated[
        str | None, typer.Option(metavar="A,B,…", help=f"Laws to test; {DEFAULT_LAWS}.")
    ] = None
    compensation: Annotated[
        str | None, typer.Option(metavar="off,on", help="Delay compensation: off, on, or both.")
    ] = None
    drive_feedback: Annotated[
        str | None,
        typer.Option(metavar="off,on", help="A drive loop: off, on, or both."),
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
        typer.Option(
            help="Search again with a tenth of estimated rotors; on unless --study or --plants."
        ),
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
        str | None, typer.Option(help="A study file, study.yaml of results, or a shipped study.")
    ] = None
    interface: InterfaceOption = None

    def definition(self) -> dict[str, Any]:
        is_own = self.study is None and self.plants is None
        is_gate = self.at_least is not None or self.baseline is not None
        given: dict[str, Any] = {
            "what_helps": True if is_own and not is_gate else None,
            "smaller_rotors": True if is_own else None,  # it may be the margin to quote, or to gate
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


@taking(MarginOptions)
def margin(options: MarginOptions) -> None:
    """Find the largest delay, or other quantity, at which each law keeps its bounds.

    The command brackets and bisects, with several starts and seeds. With --plants it finds the
    share of uncertain plants that keep their bounds at each of --values. After an interruption or a
    kill, the same command continues.
    """
    path, values = Path("margin"), dict[str, Any]()
    if options.study is not None:
        path = find_yaml(options.study, SHIPPED, fits=lambda file: not is_sweep(file))
        values = definition_in(path)
    run_study(margin_study(definition_with(options, values), path), options)
