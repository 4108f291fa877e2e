"""Results: a summary, a page and their files; and those of a run.

Every command imports this module, so it imports figures only where it needs them.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from bus_schema.recording.atomic_files import write_json, write_whole
from deploy.judge.tested_with import TESTED_WITH
from deploy.judge.verdict import Verdict, decide
from deploy.reports.page import Page
from deploy.reports.runs.run_pages import run_page
from deploy.reports.tables import quotable
from deploy.run.confirmation import CONFIRMATION
from deploy.run.execute import JudgedRun
from deploy.run.fault_record import write_fault_record
from deploy.run.run_folder import ResultFolder, RunFolder, read_manifest, read_summary
from deploy.run.stop_signals import end_if_asked

TABLE_FILE = "table.md"


@dataclass
class Results:
    """Judged results.

    Attributes:
        summary: content of ``summary.json``.
        page: what report and terminal show; None if there is nothing to show.
        runs: the recorded runs; none of a study that keeps only rows.
    """

    summary: dict[str, Any]
    page: Page[Any] | None
    runs: Sequence[JudgedRun] = ()

    @property
    def is_damaged(self) -> bool:
        """Whether a recording is damaged."""
        return any(run.result.recording.damage for run in self.runs)


Again = tuple[ResultFolder, Callable[[], Results]]
"""The folder, to be locked, and a function that then judges its results and writes their files."""


def write_results(folder: ResultFolder, results: Results, *, draws_report: bool = True) -> Results:
    """Write summary and report, and the table for documents if the page has one.

    Until all is written, the summary says that the results are not complete.

    Args:
        folder: their folder.
        results: the results.
        draws_report: whether to draw the report, which takes longer than all else.
    """
    write_json(folder.summary, {**results.summary, "completed": False})
    if results.page is not None and draws_report:
        _write_report(folder, results.page)
    quoted = None if results.page is None else results.page.quoted
    if quoted is not None:
        conditions = results.summary.get("conditions", {})
        write_whole(folder.path / TABLE_FILE, quotable(quoted(), conditions))
    write_json(folder.summary, results.summary)
    return results


def run_results(folder: RunFolder, run: JudgedRun) -> Results:
    """Judge a run; a confirmation in its folder is kept."""
    before, manifest = read_summary(folder.path), read_manifest(folder.path)
    run.result = run.result.replaced(
        confirmation=run.result.confirmation or before.get(CONFIRMATION) or None,
        tested_with=manifest.get(TESTED_WITH),
    )
    return Results(run.summary, run_page(run, manifest), [run])


def write_run(folder: RunFolder, run: JudgedRun, *, draws_report: bool = True) -> Results:
    """Judge a run, and write its summary, its report and the record of its fault.

    A file that cannot be written is a fault of the run.

    Args:
        folder: its folder.
        run: the run.
        draws_report: as for `write_results`.
    """
    results = run_results(folder, run)
    unfinished = run.result.with_verdict(Verdict.INTERRUPTED)  # until all is there
    write_json(folder.summary, unfinished.model_dump())
    try:
        write_fault_record(run.data, folder.fault)
        end_if_asked()
        if draws_report and results.page is not None:
            _write_report(folder, results.page)
    except OSError as error:
        failure = f"{error.filename}: cannot be written: {error.strerror}"
        faults = [*run.result.faults, failure]
        run.result = run.result.replaced(faults=faults).with_verdict(decide(faults))
        results = run_results(folder, run)
    with contextlib.suppress(OSError):  # a full disk keeps the earlier one
        write_json(folder.summary, run.summary)
    return results


def load_report() -> None:
    """Import what draws the report of a run, which takes some time."""
    from deploy.reports import html  # noqa: F401
    from deploy.reports.runs import run_panels  # noqa: F401


def _write_report(folder: ResultFolder, page: Page[Any]) -> None:
    from deploy.reports.html import write_page  # heavy

    end_if_asked()
    write_page(folder.report, page)
