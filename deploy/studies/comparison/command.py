"""The command `compare`."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import typer

from deploy.cli.parts.common import parse_laws
from deploy.cli.parts.options import Confirm, GateOptions, RequireBounds, ScenarioArgument, taking
from deploy.cli.parts.study_command import run_study
from deploy.cli.parts.study_options import DEFAULT_LAWS, WorkerOptions
from deploy.studies.comparison.comparison import LawComparison
from deploy.study.comparison.settling import OFFSETS_RAD


@dataclass(kw_only=True)
class CompareOptions(GateOptions, WorkerOptions):
    """The options of `compare`."""

    scenario: ScenarioArgument = "paper_arm"
    laws: Annotated[
        str | None, typer.Option(metavar="A,B,…", help=f"Laws to compare; {DEFAULT_LAWS}.")
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


@taking(CompareOptions)
def compare(options: CompareOptions) -> None:
    """Run a scenario under several laws in virtual time, and compare the results.

    After an interruption or a kill, the same command continues. With more laws, it adds them.
    """
    run_study(
        LawComparison(options.definition(), Path("compare")), options,
        require_bounds=options.require_bounds,
    )  # fmt: skip
