"""Files of a robot's data sheet: its summary and its page."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from deploy.reports.results import Again, Results, write_results
from deploy.run.run_folder import ResultFolder, read_summary
from deploy.studies.datasheet.result import RobotRun, RobotSheetResult
from deploy.studies.datasheet.robot_page import headline, robot_sheet_page, ways_of
from deploy.studies.datasheet.robot_sheet import RobotSheet
from deploy.studies.margin.result import MarginResult

KIND = "robot_datasheet"


def robot_sheet_again(path: Path) -> Again:
    """Write a robot's data sheet again from its summary."""
    folder = ResultFolder(path.resolve())
    summary = read_summary(folder.path)
    result = RobotSheetResult.model_validate(summary)
    return folder, lambda: _written(folder, result, summary["margin"])


def write_robot_sheet(
    folder: ResultFolder, sheet: RobotSheet, margin: dict[str, Any], runs: list[RobotRun]
) -> Results:
    """Write summary and page of a robot's data sheet.

    Args:
        folder: its folder.
        sheet: what it is about.
        margin: summary of its search for margins.
        runs: what its runs found.
    """
    found = MarginResult.model_validate(margin)
    arm = found.cases[0].arm
    result = RobotSheetResult(
        kind=KIND, name=arm, arm=arm, interface=sheet.interface, law=sheet.law,
        network=sheet.network, duration_s=sheet.duration_s, completed=True,
        runs=len(runs) + found.runs, runs_failed=found.runs_failed, conditions=found.conditions,
        tested_with=found.tested_with, runs_of_robot=runs, margin=found, ways=[],
    )  # fmt: skip
    return _written(folder, result, margin)


def _written(folder: ResultFolder, result: RobotSheetResult, margin: dict[str, Any]) -> Results:
    result.ways = ways_of(result.asked)
    result.headline = headline(result)
    summary = {**result.to_json(), "margin": margin}  # which has its nulls
    return write_results(folder, Results(summary, robot_sheet_page(result)))
