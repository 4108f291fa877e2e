"""The command `tune`."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import typer

from controller.laws import COMPARED_LAWS
from deploy.cli.parts.common import parse_laws
from deploy.cli.parts.options import ScenarioArgument, taking
from deploy.cli.parts.study_command import run_study
from deploy.cli.parts.study_options import StudyOptions, listed
from deploy.scenario.yaml_files import ScenarioError, read_yaml
from deploy.studies.tune.tuning import Tuning


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


@taking(TuneOptions)
def tune(options: TuneOptions) -> None:
    """Search for the gains of laws: the same search, budget and runs for each of them.

    The gains that were found are judged with another seed, start and reference and on uncertain
    plants, and written to a scenario for each law. After an interruption or a kill, the same
    command continues; so does one with a larger --budget.
    """
    run_study(Tuning(options.definition(), Path("tune")), options)
