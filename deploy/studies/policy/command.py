"""The command `policy`: how long the inference of a policy may take, with each merge of chunks."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any

import typer

from bus_schema.foreign_text import shortened
from bus_schema.user_files import is_folder
from controller.law_choice import is_law_name
from controller.policies.configuration import is_address
from deploy.cli.parts.common import parse_laws
from deploy.cli.parts.options import GateOptions, NetworkOption, taking
from deploy.cli.parts.study_command import run_study
from deploy.cli.parts.study_options import WorkerOptions
from deploy.scenario.yaml_files import ScenarioError
from deploy.studies.policy.policy import PolicyStudy


@dataclass(kw_only=True)
class PolicyOptions(GateOptions, WorkerOptions):
    """The options of `policy`."""

    law: Annotated[
        str,
        typer.Argument(
            metavar="POLICY",
            help="MODULE:CLASS, or a server: lerobot://HOST:PORT or openpi://HOST:PORT.",
        ),
    ]
    scenario: Annotated[
        list[str] | None,
        typer.Argument(help="Scenario files or shipped scenarios; default paper_arm."),
    ] = None
    merges: Annotated[
        str | None, typer.Option(metavar="A,B,…", help="Merges to try; by default all but waiting.")
    ] = None
    network: NetworkOption = None
    at: Annotated[
        float, typer.Option(min=0, metavar="MS", help="Inference time to compare merges at.")
    ] = 100.0
    limit: Annotated[float, typer.Option(min=1, metavar="MS", help="Largest one to try.")] = 300.0
    resolution: Annotated[
        float, typer.Option(min=0.1, metavar="MS", help="From one to the next.")
    ] = 25.0
    tasks: Annotated[
        int | None, typer.Option(min=1, metavar="N", help="Number of tasks of a drawn reference.")
    ] = None

    def definition(self) -> dict[str, Any]:
        """Return the study that the options describe."""
        if not is_law_name(self.law) and is_folder(Path(self.law)):
            modules = sorted(file.stem for file in Path(self.law).glob("*.py"))
            found = f" (modules in it: {shortened(', '.join(modules))})" if modules else ""
            allowed = "must be MODULE:CLASS, or a server that has it, as lerobot://HOST:PORT"
            raise ScenarioError(f"POLICY {shortened(self.law)}: is a folder{found}: {allowed}")
        laws = parse_laws(self.law, "POLICY") or []
        if len(laws) != 1:
            raise ScenarioError(f"POLICY {shortened(self.law)}: must be one policy")
        given = {
            "merges": None if self.merges is None else [m.strip() for m in self.merges.split(",")],
            "network": self.network, "tasks": self.tasks,
        }  # fmt: skip
        return {
            "scenarios": self.scenario or ["paper_arm"], "law": laws[0],
            "at_ms": self.at, "limit_ms": self.limit, "resolution_ms": self.resolution,
            "set": self.fixed(), **{k: v for k, v in given.items() if v is not None},
        }  # fmt: skip


@taking(PolicyOptions)
def policy(options: PolicyOptions) -> None:
    """Find how long the inference of a policy may take, with each merge of its chunks.

    Each merge runs at each inference time. The result is the largest one at which the bounds are
    kept, and jumps, jerk and ages at one of them. After an interruption or a kill, the same command
    continues.
    """
    if is_address(options.law) and options.workers is None and options.scheduler is None:
        options = replace(options, workers=1)  # a server of LeRobot has one client
    run_study(PolicyStudy(options.definition(), Path("policy")), options)
