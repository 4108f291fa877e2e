"""Results of a run, of runs side by side or of a study: a summary, a page and their files.

Every command imports this module, so it imports figures and studies only where it needs them.
"""

from __future__ import annotations

import contextlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

from bus_schema.recording.atomic_files import write_json, write_whole
from deploy.judge.conditions import conditions_of_recording, conditions_of_runs
from deploy.judge.run_rows import read_rows, write_rows
from deploy.judge.tested_with import TESTED_WITH
from deploy.judge.verdict import Verdict, decide
from deploy.reports.kinds import kind_of
from deploy.reports.page import Cards, Fact, Page
from deploy.reports.runs.run_pages import diff_page, laws_page, run_page
from deploy.reports.runs.run_tables import confirmation_tables
from deploy.reports.tables import quotable
from deploy.reports.verdict_texts import ReportHead
from deploy.run.confirmation import CONFIRMATION, CONFIRMATION_COLUMNS
from deploy.run.execute import JudgedRun
from deploy.run.fault_record import write_fault_record
from deploy.run.run_folder import ResultFolder, RunFolder, read_manifest, read_summary
from deploy.run.stop_signals import end_if_asked
from deploy.study.comparison.comparison import COLUMNS, KIND, ComparedRuns, compared_in, rows_again

if TYPE_CHECKING:
    from deploy.study.comparison.recorded import RecordedRuns
    from deploy.study.execution.folder import StudyFolder
    from deploy.study.study import StudyOfRuns

TABLE_FILE = "table.md"
_REUSE = "reuse"
"""Condition of rows that later commands make again."""


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


def write_results(folder: ResultFolder, results: Results, *, draws_report: bool = True) -> Results:
    """Write summary and report, and the table for documents if the kind has one.

    Until all is written, the summary says that the results are not complete.

    Args:
        folder: their folder.
        results: the results.
        draws_report: whether to draw the report, which takes longer than all else.
    """
    write_json(folder.summary, {**results.summary, "completed": False})
    if results.page is not None and draws_report:
        _write_report(folder, results.page)
    quoted = kind_of(results.summary).quoted
    if quoted is not None:
        conditions = results.summary.get("conditions", {})
        write_whole(folder.path / TABLE_FILE, quotable(quoted(results.summary), conditions))
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


def diff_results(compared: RecordedRuns) -> Results:
    """Judge recorded runs side by side."""
    from deploy.study.comparison.recorded import KIND as DIFF

    conditions = _conditions_of_all(compared)
    summary = {
        "kind": DIFF,
        "name": " ".join(compared.labels),
        "completed": True,
        "runs": {run.law: run.summary for run in compared.runs},
        "paths": [str(path.resolve()) for path in compared.paths],
        "partings": [parting and parting._asdict() for parting in compared.partings],
        "differing": compared.differing,
        "conditions": conditions,
    }
    return Results(summary, diff_page(compared, conditions), compared.runs)


def judge_rows(study: StudyOfRuns, folder: StudyFolder) -> dict[str, Any]:
    """Write the table of a study's rows; return its summary."""
    summary, manifest = study.summary(folder.rows), read_manifest(folder.path)
    study.keep_files(summary, folder.path)
    summary |= {TESTED_WITH: manifest.get(TESTED_WITH)}
    summary["conditions"] = study.conditions(summary, manifest)
    if folder.unseen:
        summary["conditions"][_REUSE] = folder.unseen
    folder.write(summary["conditions"], completed=summary["completed"])
    return summary


def study_results(summary: dict[str, Any], folder: StudyFolder) -> Results:
    """Return the results of a study from its summary; recordings are judged again."""
    if kind_of(summary).page is None:
        return comparison_results(folder, summary)[0]
    return Results(summary, study_page(summary, folder))


def write_study(study: StudyOfRuns, folder: StudyFolder) -> Results:
    """Judge the rows of a study, and its recordings if it has any, and write all files."""
    return write_results(folder, study_results(judge_rows(study, folder), folder))


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
    kept = {_REUSE: known[_REUSE]} if _REUSE in known else {}
    of_runs["conditions"] = {**conditions_of_runs(setups, read_manifest(folder.path)), **kept}
    before = read_rows(file) if file.is_file() else []
    confirmed = CONFIRMATION_COLUMNS if any("confirmed_on" in each for each in before) else {}
    rows, columns = rows_again(compared, before), {**COLUMNS, **confirmed}
    write_rows(rows, file, columns, of_runs["conditions"])
    page = laws_page(compared, of_runs["conditions"])
    return Results({**summary, **of_runs}, page, compared.runs), compared


def study_page(summary: dict[str, Any], folder: StudyFolder) -> Page[Any]:
    """Return the page of a study: parts of its kind, and parts that all studies share."""
    from deploy.reports.figures.study_figures import DrawnStudy  # heavy

    of_kind, seeds = kind_of(summary).page, summary["seeds"]
    if of_kind is None:
        raise ValueError(f"{summary['kind']}: has no page without its recordings")
    page = of_kind(DrawnStudy(summary, folder.rerun_command))
    runs = f"{summary['runs']}" if summary["completed"] else f"{summary['runs']}, not complete"
    others = f"; add --set seed={seeds[1]} and so on for the others" if seeds[1:] else ""
    return replace(
        page,
        verdict=_with_failures(page.verdict, summary),
        facts=[
            *page.facts,
            Fact("Runs", runs),
            Fact("Failed runs", str(summary["runs_failed"])),
            Fact("Seeds", _shortened(seeds)),
        ],
        panels=page.panels if summary["runs"] else list,
        conditions=summary.get("conditions", {}),
        results=[*page.results, Cards(confirmation_tables([summary.get(CONFIRMATION)]), "stacked")],
        points_note=f"The scenarios have seed {seeds[0]}{others}.",
        footer="All runs, one row each:",
        footer_code=folder.rows_file.name,
        shares_library=True,
    )


def _with_failures(verdict: ReportHead, summary: dict[str, Any]) -> ReportHead:
    """Return the verdict with the failed runs."""
    failed, runs = summary["runs_failed"], summary["runs"]
    if not failed:
        return verdict
    fault = (
        f"{failed} of {runs} runs failed; their rows say why. The most frequent error:"
        f" {summary['commonest_error']}"
    )
    if failed < runs:
        return replace(verdict, faults=[fault])
    return replace(verdict, faults=[fault], level="broken", headline="Every run failed")


def _shortened(seeds: Sequence[int]) -> str:
    texts = [str(seed) for seed in seeds]
    return ", ".join(texts) if len(texts) <= 6 else f"{len(texts)}: {texts[0]} … {texts[-1]}"


def load_report() -> None:
    """Import what draws the report of a run, which takes some time."""
    from deploy.reports import html  # noqa: F401
    from deploy.reports.runs import run_panels  # noqa: F401


def _write_report(folder: ResultFolder, page: Page[Any]) -> None:
    from deploy.reports.html import write_page  # heavy

    end_if_asked()
    write_page(folder.report, page)


def _conditions_of_all(compared: RecordedRuns) -> dict[str, str]:
    """Return the conditions of the runs: each once if it is the same for all."""
    by_run = [
        conditions_of_recording(run.data, manifest)
        for run, manifest in zip(compared.runs, compared.manifests, strict=True)
    ]
    merged = {}
    for name in by_run[0]:
        found = [each[name] for each in by_run]
        by_label = (f"{label}: {text}" for label, text in zip(compared.labels, found, strict=True))
        merged[name] = found[0] if len(set(found)) == 1 else "; ".join(by_label)
    return merged
