"""The command `policy`: how long the inference of a policy may take, with each merge of chunks."""

from __future__ import annotations

import threading
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any

import typer

from bus_schema.recording.atomic_files import write_json, write_whole
from controller.chunks.configuration import CHUNK_MERGES
from controller.policies.configuration import is_address
from deploy.command.common import leave, parse_laws, say_warnings
from deploy.command.options import ScenarioArgument, taking
from deploy.command.study_command import carried_out
from deploy.command.study_options import WorkerOptions
from deploy.reports.studies.results import write_study
from deploy.reports.tables import Cell, Column, Table, as_markdown, scaled
from deploy.reports.terminal import print_table
from deploy.run.console import Console
from deploy.run.exit_codes import FAULT, INTERRUPTED
from deploy.run.new_folder import resolved_out
from deploy.scenario.yaml_files import ScenarioError, naming
from deploy.studies.policy.policy_sheet import PolicySheet, recommended, shipped_merges


@dataclass(kw_only=True)
class PolicyOptions(WorkerOptions):
    """The options of `policy`."""

    law: Annotated[
        str,
        typer.Argument(
            metavar="POLICY",
            help="MODULE:CLASS, or a server: lerobot://HOST:PORT or openpi://HOST:PORT.",
        ),
    ]
    scenario: ScenarioArgument = "paper_arm"
    merges: Annotated[
        str | None, typer.Option(metavar="A,B,…", help="Merges to try; by default all but waiting.")
    ] = None
    network: Annotated[
        str | None, typer.Option(metavar="LOG", help="A file of delays, or a shipped trace.")
    ] = None
    at: Annotated[
        float, typer.Option(min=0, metavar="MS", help="Inference time to compare merges at.")
    ] = 100.0
    limit: Annotated[float, typer.Option(min=1, metavar="MS", help="Largest one to try.")] = 300.0
    resolution: Annotated[float, typer.Option(min=0.1, metavar="MS", help="Of the result.")] = 5.0


@taking(PolicyOptions)
def policy(options: PolicyOptions) -> None:
    """Find how long the inference of a policy may take, with each merge of its chunks.

    For each merge: the largest inference time at which the bounds are kept; and, at one inference
    time, jumps, ages of observations, and the tip's error. After an interruption or a kill, the
    same command continues.
    """
    parse_laws(options.law, "POLICY")
    if is_address(options.law) and options.workers is None and options.scheduler is None:
        options = replace(options, workers=1)  # a server of LeRobot has one client
    sheet = PolicySheet(
        options.scenario, options.law, _merges(options.merges), options.network, options.at,
        options.limit, options.resolution, options.fixed(),
    )  # fmt: skip
    console, stop = Console(), threading.Event()
    studies = {merge: sheet.margin(merge) for merge in sheet.merges}  # refuses before any run
    setups = [sheet.setup(merge) for merge in sheet.merges]
    say_warnings(setups[0])
    name = f"policy-{setups[0].scenario.name}"
    out = resolved_out(options.out or Path("runs", name))
    rows = []
    for merge, study in studies.items():
        own = replace(options, out=out / merge)
        with carried_out(study, own, console, stop) as done:
            summary = write_study(study, done.folder).summary
        if stop.is_set():
            console.print("stopped: repeat the same command to continue.", markup=False)
            raise typer.Exit(INTERRUPTED)
        if summary["runs_failed"] == summary["runs"]:
            console.print(f"{merge}: {summary['commonest_error']}", markup=False)
            raise typer.Exit(FAULT)
        rows.append({"merge": merge, **_largest(summary), **sheet.compared(merge)})
    best = recommended(rows)
    values = {
        "policy": options.law, "scenario": setups[0].scenario.name, "network": options.network,
        "at_ms": options.at, "limit_ms": options.limit, "merges": rows, "recommended": best,
    }  # fmt: skip
    write_json(out / "policy.json", values)
    table = _table(values)
    write_whole(out / "policy.md", f"{as_markdown(table)}\n\n{table.note}\n")
    print_table(console, table)
    console.print(table.note, markup=False)
    console.print(f"results: {out}", markup=False, highlight=False)
    leave(interrupted=False, whole=True, kept=True)


def _merges(text: str | None) -> list[str]:
    if text is None:
        return shipped_merges()
    names = [name.strip() for name in text.split(",")]
    with naming(Path("--merges")):
        for name in names:
            CHUNK_MERGES.check(name)
    if len(set(names)) < len(names):
        raise ScenarioError(f"--merges {text}: must be different ones")
    return names


def _largest(summary: dict[str, Any]) -> dict[str, Any]:
    """Return the largest inference time of a search, whether it is the limit, and what ends it."""
    [case] = summary["cases"]
    failed = [probe for probe in case["probes"] if probe["value"] == case["first_failure"]]
    losses = failed[0]["losses"] if failed else {}
    return {
        "inference_ms": case["margin"], "is_limit": case["first_failure"] is None,
        "ends": max(losses, key=lambda reason: losses[reason], default=None),
    }  # fmt: skip


def _table(values: dict[str, Any]) -> Table:
    columns = [
        Column("Merge", is_text=True), Column("Largest inference", "ms"),
        Column("Ends by", is_text=True),
        Column("Largest jump", "mrad"), Column("At the tip", "mm"), Column("Age, median", "ms"),
        Column("Age, largest", "ms"), Column("Without a row", "%"), Column("Tip error, RMS", "mm"),
    ]  # fmt: skip
    rows = [
        [
            Cell(row["merge"], "best" if row["merge"] == values["recommended"] else ""),
            f"≥ {row['inference_ms']:g}" if row["is_limit"] else row["inference_ms"],
            row["ends"], scaled(row["jump_rad"], 1e3), row["jump_mm"],
            row["age_median_ms"], row["age_largest_ms"], scaled(row["starved_share"], 100.0),
            row["tip_error_rms_mm"],
        ]
        for row in values["merges"]
    ]  # fmt: skip
    best = values["recommended"]
    advice = "No merge keeps the bounds." if best is None else f"Recommended: {best}."
    note = (
        f"{advice} Largest inference times up to {values['limit_ms']:g} ms, one seed and start;"
        f" jumps, ages and errors at {values['at_ms']:g} ms."
    )
    return Table(f"{values['policy']} on {values['scenario']}", columns, rows, note)
