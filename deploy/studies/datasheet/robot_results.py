"""Files of a robot's data sheet: its summary and its page."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from deploy.judge.conditions import networks_of
from deploy.judge.tested_with import TESTED_WITH
from deploy.reports.results import Again, Results, write_results
from deploy.run.run_folder import ResultFolder, read_summary
from deploy.studies.datasheet.data_sheet import network_files
from deploy.studies.datasheet.robot_page import headline, robot_sheet_page, summaries_of
from deploy.studies.datasheet.robot_sheet import RobotSheet

KIND = "robot_datasheet"


def robot_sheet_again(path: Path) -> Again:
    """Write a robot's data sheet again from its summary."""
    folder = ResultFolder(path.resolve())
    return folder, lambda: _written(folder, dict(read_summary(folder.path)))


def write_robot_sheet(
    folder: ResultFolder, sheet: RobotSheet, margin: dict[str, Any], runs: list[dict[str, Any]]
) -> Results:
    """Write summary and page of a robot's data sheet.

    Args:
        folder: its folder.
        sheet: what it is about.
        margin: summary of its search for margins.
        runs: what its runs found.
    """
    [arm, *_] = (case["arm"] for case in margin["cases"])
    summary: dict[str, Any] = {
        "kind": KIND,
        "name": arm,
        "arm": arm,
        "interface": sheet.interface,
        "law": sheet.law,
        "network": sheet.network,
        "duration_s": sheet.duration_s,
        "completed": True,
        "runs": len(runs) + margin["runs"],
        "runs_failed": margin["runs_failed"],
        "conditions": {**margin["conditions"], **networks_of(network_files(sheet.network))},
        TESTED_WITH: margin.get(TESTED_WITH),
        "runs_of_robot": runs,
        "margin": margin,
    }
    return _written(folder, summary)


def _written(folder: ResultFolder, summary: dict[str, Any]) -> Results:
    summary["ways"] = summaries_of(summary["runs_of_robot"])
    summary["headline"] = headline(summary)
    return write_results(folder, Results(summary, robot_sheet_page(summary)))
