"""Results of a comparison: its recordings judged, and the table of its rows."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from deploy.judge.conditions import conditions_of_runs
from deploy.judge.run_rows import read_rows, write_rows
from deploy.reports.results import Again, Results, write_results
from deploy.reports.studies.results import REUSE
from deploy.run.confirmation import CONFIRMATION_COLUMNS
from deploy.run.run_folder import ResultFolder, read_manifest, read_summary
from deploy.studies.comparison.page import laws_page
from deploy.study.comparison.compared_runs import (
    COLUMNS,
    KIND,
    ComparedRuns,
    compared_in,
    rows_again,
)


def comparison_results(
    folder: ResultFolder, summary: Mapping[str, Any]
) -> tuple[Results, ComparedRuns]:
    """Judge the recordings of a comparison, and write the table of its rows.

    Args:
        folder: their folder.
        summary: summary of its rows, or in its folder.

    Raises:
        RunFolderError: a recording is missing or cannot be read.
    """
    compared, file = compared_in(folder.path, summary), folder.path / f"{KIND}.parquet"
    setups = [run.data.setup for run in compared.runs]
    of_runs: dict[str, Any] = {"laws": {run.law: run.summary for run in compared.runs}}
    if not setups:
        return Results({**summary, **of_runs}, None), compared
    of_runs["clock"] = compared.runs[0].result.clock
    known = summary.get("conditions", {})
    kept = {REUSE: known[REUSE]} if REUSE in known else {}
    of_runs["conditions"] = {**conditions_of_runs(setups, read_manifest(folder.path)), **kept}
    before = read_rows(file) if file.is_file() else []
    confirmed = CONFIRMATION_COLUMNS if any("confirmed_on" in each for each in before) else {}
    rows, columns = rows_again(compared, before), {**COLUMNS, **confirmed}
    write_rows(rows, file, columns, of_runs["conditions"])
    page = laws_page(compared, of_runs["conditions"])
    return Results({**summary, **of_runs}, page, compared.runs), compared


def judged(folder: ResultFolder, summary: Mapping[str, Any]) -> Results:
    """Return the results alone, as `comparison_results` has them."""
    return comparison_results(folder, summary)[0]


def laws_again(path: Path) -> Again:
    """Judge the recordings of a comparison; its study may have changed, or be of an old version."""
    folder = ResultFolder(path.resolve())

    return folder, lambda: write_results(folder, judged(folder, read_summary(folder.path)))
