"""The command `sweep`."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import typer

from deploy.cli.parts.options import GateOptions, taking
from deploy.cli.parts.study_command import run_study
from deploy.cli.parts.study_options import ConfirmedStudyOptions
from deploy.studies.sweep.sweep import load_sweep


@dataclass(kw_only=True)
class SweepOptions(GateOptions, ConfirmedStudyOptions):
    """The options of `sweep`."""

    sweep: Annotated[
        str, typer.Argument(metavar="SWEEP", help="A sweep file, or the name of a shipped one.")
    ]


@taking(SweepOptions)
def sweep(options: SweepOptions) -> None:
    """Run every point of a grid with every seed, on all cores or a Dask cluster.

    With --plants, each point runs with that many uncertain plants. After an interruption or a kill,
    the same command continues.
    """
    run_study(load_sweep(options.sweep, options.definition(), options.fixed()), options)
