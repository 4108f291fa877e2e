"""The command `datasheet`: one command to the answer how much delay an arm takes."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import typer

from deploy.cli.common import CommandGate, conclude, leave
from deploy.cli.options import ScenarioArgument, taking
from deploy.cli.study.margin_options import WorkerOptions
from deploy.cli.study.studies import carried_out
from deploy.judge.run_rows import Row
from deploy.reports.data_sheet_results import write_data_sheet, written_window
from deploy.reports.results import write_study
from deploy.run.console import Console
from deploy.run.exit_codes import FAULT, INTERRUPTED
from deploy.run.new_folder import resolved_out
from deploy.run.run_folder import ResultFolder
from deploy.scenario.yaml_files import ScenarioError
from deploy.study.data_sheet import DataSheet, any_pattern_ms
from deploy.study.study import StudyOfRuns


@dataclass(kw_only=True)
class DatasheetOptions(WorkerOptions):
    """The options of `datasheet`."""

    scenario: ScenarioArgument = "paper_arm"
    law: Annotated[str, typer.Option(help="The control law.")] = "fixed_time_adaptive"
    network: Annotated[
        str | None, typer.Option(metavar="LOG", help="A file of delays, or a shipped trace.")
    ] = None
    plants: Annotated[int, typer.Option(min=0, help="Number of uncertain plants.")] = 0
    quick: Annotated[bool, typer.Option("--quick", help="Fewer and shorter runs.")] = False


@taking(DatasheetOptions)
def datasheet(options: DatasheetOptions) -> None:
    """Answer how much delay an arm takes: constant, of any pattern, on a network, as many plants.

    One folder and one page with the answer in one sentence, the worst window of the network, and
    what helps. After an interruption or a kill, the same command continues.
    """
    if options.confirm:
        raise ScenarioError("--confirm: must be left out: margin and sweep have it")
    console = Console()
    sheet = DataSheet(
        options.scenario, options.law, options.network, options.plants, options.fixed(),
        options.quick,
    )  # fmt: skip
    first = {"margin": sheet.margin(), "network": sheet.windows()}
    gate = CommandGate(options, "datasheet", "ms", "datasheet")
    out = resolved_out(options.out or Path("runs", f"datasheet-{Path(options.scenario).stem}"))
    out.mkdir(parents=True, exist_ok=True)
    parts: dict[str, Any] = {}
    rows: dict[str, list[Row]] = {}

    def make(name: str, study: StudyOfRuns | None) -> None:
        if study is None:
            return
        options.out = out / name
        with carried_out(study, options, console) as done:
            parts[name] = write_study(study, done.folder).summary
            rows[name] = done.folder.rows
        if not parts[name]["completed"]:
            console.print(f"{done.lost or 'stopped'}: repeat the same command to continue.")
            raise typer.Exit(INTERRUPTED if done.is_interrupted else FAULT)

    for name, study in first.items():
        make(name, study)
    with_compensation = parts["margin"]["cases"][-1]
    make("plants", sheet.of_plants(any_pattern_ms(with_compensation) or 0.0))
    window = written_window(first["network"], rows.get("network", []), out / "worst_window")
    with ResultFolder(out).lock() as folder:
        results = conclude(console, folder, lambda: write_data_sheet(folder, sheet, parts, window))
    kept = gate.is_passed(results.summary, console)
    leave(interrupted=False, whole=True, kept=kept)
