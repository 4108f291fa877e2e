"""Files of data sheets: summary, page, and the run on the worst window of the network."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

from bus_schema.recording.atomic_files import write_whole
from deploy.judge.conditions import EFFORT, networks_of
from deploy.judge.run_rows import Row
from deploy.reports.results import Again, Results, write_results, write_run
from deploy.run.execute import JudgedRun, execute
from deploy.run.new_folder import new_folder, resolved_out
from deploy.run.run_folder import ResultFolder, RunFolder, load_run, read_summary
from deploy.scenario.scenario import load_setup
from deploy.scenario.yaml_files import ScenarioError, override, read_yaml, to_yaml
from deploy.scenario.yaml_text import values_of
from deploy.studies.datasheet import robot_page
from deploy.studies.datasheet.data_sheet import (
    DataSheet,
    network_files,
    smooth_playout_ms,
    worst_window,
)
from deploy.studies.datasheet.page import DrawnSheet, data_sheet_page, headline, quote_of
from deploy.studies.datasheet.result import (
    DataSheetResult,
    Parts,
    RobotRun,
    RobotSheetResult,
    effort_text,
)
from deploy.studies.datasheet.robot_sheet import RobotSheet
from deploy.studies.margin.result import MarginResult
from deploy.study.study import StudyOfRuns, digest_of

FILE = "datasheet.yaml"
_PARTS = ("margin", "network", "plants")
_WINDOW = "worst_window"
OF_ROBOT = "robot_datasheet"

DoPart = Callable[[StudyOfRuns, Path], tuple[dict[str, Any], list[Row]]]
"""Runs a study in a folder; returns its summary and rows."""


def sheet_folder(sheet: DataSheet | RobotSheet, out: Path | None, *, overwrite: bool) -> Path:
    """Return the folder of a data sheet, in which an earlier command may have begun it.

    Args:
        sheet: the data sheet.
        out: the requested folder; by default one in ``runs`` for each data sheet.
        overwrite: remove the data sheet, or other results, in it.

    Raises:
        ScenarioError: it has another data sheet or other results, or cannot be created.
    """
    values: dict[str, Any] = {key: value for key, value in asdict(sheet).items() if value}
    digest = digest_of(to_yaml(values).encode())[:8]
    path = resolved_out(out or Path("runs", f"datasheet-{Path(sheet.arm).stem}-{digest}"))
    file = path / FILE
    if file.is_file() and not overwrite:
        if read_yaml(file) != values_of(to_yaml(values)):
            raise ScenarioError(f"--out {path}: has another data sheet, see {file}: use another"
                                " folder, or --overwrite")  # fmt: skip
        return path
    new_folder("datasheet", path, overwrite=overwrite)
    for name in (*_PARTS, _WINDOW) if file.is_file() else ():
        shutil.rmtree(path / name, ignore_errors=True)
    write_whole(file, to_yaml(values))
    return path


def sheet_again(path: Path) -> Again:
    """Write a data sheet again from the summaries of its parts."""
    folder = ResultFolder(path.resolve())
    sheet = DataSheet(**read_yaml(folder.path / FILE))
    found = {name: read_summary(folder.path / name) for name in _PARTS}
    window = folder.path / _WINDOW
    run = JudgedRun(_WINDOW, load_run(window)[0], path=window) if window.is_dir() else None
    parts = {name: summary for name, summary in found.items() if summary}
    return folder, lambda: write_data_sheet(folder, sheet, parts, run)


def sheet_parts(
    sheet: DataSheet, margin: StudyOfRuns, windows: StudyOfRuns | None, out: Path, do: DoPart
) -> tuple[dict[str, Any], JudgedRun | None]:
    """Run the studies of a data sheet; return their summaries by name, and the worst window.

    Args:
        sheet: the data sheet.
        margin: its search for margins.
        windows: its runs on a network; None without a network.
        out: its folder.
        do: runs one of its studies.
    """
    rows: list[Row] = []
    parts = {"margin": do(margin, out / "margin")[0]}
    if windows is not None:
        parts["network"], rows = do(windows, out / "network")
    found = MarginResult.model_validate(parts["margin"])
    plants = sheet.of_plants(found.cases[-1].any_pattern or 0.0)
    if plants is not None:
        parts["plants"] = do(plants, out / "plants")[0]
    return parts, _written_window(windows, rows, out)


def _written_window(study: StudyOfRuns | None, rows: list[Row], folder: Path) -> JudgedRun | None:
    """Run the worst window of a network again, recorded, with a report; None without a network."""
    if study is None or not rows:
        return None
    worst = worst_window(rows)
    run = next(run for run in study.first() if run.key == (worst["point"], worst["seed"]))
    setup = load_setup(run.scenario, [*run.overrides, f"seed={run.seed}"])
    with RunFolder.begin(setup, folder / _WINDOW, overwrite=True) as own:
        done = execute(setup, None, own)
        write_run(own, done)
    return done


def _conditions(sheet: DataSheet | RobotSheet, margin: MarginResult) -> dict[str, str]:
    effort = effort_text(margin, sheet.duration_s, is_quick=sheet.is_quick)
    networks = networks_of(network_files(sheet.network))
    given = ", ".join(override(key, value) for key, value in sheet.all_set.items()) or "nothing"
    return {**margin.conditions, **networks, EFFORT: effort, "set": given}


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
    found = Parts.model_validate(parts)
    margin, studies = found.margin, found.all.values()
    result = DataSheetResult(
        kind="datasheet", name=margin.cases[0].arm, arm=margin.cases[0].arm, law=sheet.law,
        network=sheet.network, duration_s=sheet.duration_s, completed=True,
        runs=sum(part.runs for part in studies),
        runs_failed=sum(part.runs_failed for part in studies),
        folders={name: f"{name}/report.html" for name in parts},
        worst_window=None if window is None else window.summary["bounds"],
        conditions=_conditions(sheet, margin), quick=sheet.is_quick,
        tested_with=sheet.tested_with(margin.tested_with),
        parts=found,
    )  # fmt: skip
    result.headline, result.quote = headline(result), quote_of(result)
    summary = {**result.to_json(), "parts": dict(parts)}  # which have their nulls
    return write_results(folder, Results(summary, data_sheet_page(DrawnSheet(result, window))))


def robot_sheet_again(path: Path) -> Again:
    """Write a robot's data sheet again from its summary."""
    folder = ResultFolder(path.resolve())
    summary = read_summary(folder.path)
    result = RobotSheetResult.model_validate(summary)
    return folder, lambda: _of_robot(folder, result, summary["margin"])


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
        kind=OF_ROBOT, name=arm, arm=arm, interface=sheet.interface, law=sheet.law,
        network=sheet.network, duration_s=sheet.duration_s, completed=True,
        smooth_playout_ms=None if sheet.network is None else smooth_playout_ms(sheet.network),
        runs=len(runs) + found.runs, runs_failed=found.runs_failed,
        conditions=_conditions(sheet, found), quick=sheet.is_quick,
        tested_with=found.tested_with, runs_of_robot=runs, margin=found, ways=[],
    )  # fmt: skip
    return _of_robot(folder, result, margin)


def _of_robot(folder: ResultFolder, result: RobotSheetResult, margin: dict[str, Any]) -> Results:
    result.ways = robot_page.ways_of(result.asked)
    result.headline = robot_page.headline(result)
    summary = {**result.to_json(), "margin": margin}  # which has its nulls
    return write_results(folder, Results(summary, robot_page.robot_sheet_page(result)))
