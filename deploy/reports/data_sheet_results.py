"""Files of a data sheet: its summary, its page, and the run on the worst window of the network."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from bus_schema.recording.atomic_files import write_json
from deploy.judge.run_rows import Row
from deploy.reports.data_sheet_page import DrawnSheet, data_sheet_page, headline
from deploy.reports.results import Results, write_results, write_run
from deploy.run.execute import JudgedRun, execute
from deploy.run.run_folder import ResultFolder, RunFolder, provenance
from deploy.scenario.scenario import load_setup
from deploy.study.data_sheet import DataSheet, worst_window
from deploy.study.study import StudyOfRuns


def written_window(study: StudyOfRuns | None, rows: list[Row], path: Path) -> JudgedRun | None:
    """Run the worst window of a network again, recorded, with a report; None without a network."""
    if study is None or not rows:
        return None
    worst = worst_window(rows)
    run = next(run for run in study.first() if run.key == (worst["point"], worst["seed"]))
    setup = load_setup(run.scenario, [*run.overrides, f"seed={run.seed}"])
    with RunFolder.begin(setup, path, overwrite=True) as folder:
        done = execute(setup, None, folder)
        write_run(folder, done)
    return done


def write_data_sheet(
    folder: ResultFolder, sheet: DataSheet, parts: Mapping[str, Any], window: JudgedRun | None
) -> Results:
    """Write summary and page of a data sheet.

    Args:
        folder: its folder.
        sheet: what it is about.
        parts: summaries of its studies by name, each in a folder of that name.
        window: the run on the worst window of the network.
    """
    margin = parts["margin"]
    conditions = margin["conditions"]
    summary: dict[str, Any] = {
        "kind": "datasheet",
        "name": margin["cases"][0]["arm"],
        "arm": margin["cases"][0]["arm"],
        "law": sheet.law,
        "network": sheet.network,
        "duration_s": sheet.duration_s,
        "completed": True,
        "runs": sum(part["runs"] for part in parts.values()),
        "runs_failed": sum(part["runs_failed"] for part in parts.values()),
        "folders": {name: f"{name}/report.html" for name in parts},
        "worst_window": None if window is None else window.summary["bounds"],
        "conditions": conditions,
        "parts": dict(parts),
    }
    summary["headline"] = headline(summary)
    write_json(folder.manifest, provenance())
    return write_results(folder, Results(summary, data_sheet_page(DrawnSheet(summary, window))))
