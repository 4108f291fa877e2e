"""Results of studies: their summaries, pages and files."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

from deploy.judge.conditions import seeds_text
from deploy.judge.tested_with import TESTED_WITH
from deploy.reports.kinds import kind_of
from deploy.reports.page import Cards, Fact, Page, ReportHead
from deploy.reports.results import Results, write_results
from deploy.reports.runs.run_tables import confirmation_tables
from deploy.run.confirmation import CONFIRMATION
from deploy.run.run_folder import read_manifest

if TYPE_CHECKING:
    from deploy.study.execution.folder import StudyFolder
    from deploy.study.study import StudyOfRuns


_MOST_SEEDS = 6
REUSE = "reuse"
"""Condition of rows that later commands make again."""


def judge_rows(study: StudyOfRuns, folder: StudyFolder) -> dict[str, Any]:
    """Write the table of a study's rows; return its summary."""
    summary, manifest = study.summary(folder.rows), read_manifest(folder.path)
    study.keep_files(summary, folder.path)
    summary |= {TESTED_WITH: manifest.get(TESTED_WITH)}
    summary["conditions"] = study.conditions(summary, manifest)
    if folder.unseen:
        summary["conditions"][REUSE] = folder.unseen
    folder.write(summary["conditions"], completed=summary["completed"])
    return summary


def study_results(summary: dict[str, Any], folder: StudyFolder) -> Results:
    """Return the results of a study from its summary; recordings are judged again."""
    judged = kind_of(summary).judged
    return (
        Results(summary, study_page(summary, folder)) if judged is None else judged(folder, summary)
    )


def write_study(study: StudyOfRuns, folder: StudyFolder) -> Results:
    """Judge the rows of a study, and its recordings if it has any, and write all files."""
    return write_results(folder, study_results(judge_rows(study, folder), folder))


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
            Fact("Seeds", seeds_text(seeds, _MOST_SEEDS)),
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
