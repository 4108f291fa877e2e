"""Reports of studies, made of their summaries alone."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

from deploy.reports.figures.study_figures import DrawnStudy
from deploy.reports.margin_reports import margin_page, robustness_page
from deploy.reports.page import Cards, Fact, Page, write_page
from deploy.reports.run_tables import confirmation_tables
from deploy.reports.sweep_report import sweep_page
from deploy.reports.verdict import ReportHead
from deploy.study.folder import StudyFolder

_PAGES = {"sweep": sweep_page, "margin": margin_page, "robustness": robustness_page}
"""What is particular to each kind of study."""


def page_of(study: DrawnStudy) -> Page[DrawnStudy]:
    """The page of a study: what is particular to its kind, and what all studies have."""
    summary = study.summary
    page, seeds = _PAGES[summary["kind"]](study), summary["seeds"]
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
        panels=page.panels if summary["runs"] else (),
        conditions=summary.get("conditions", {}),
        after=("Results", [*page.after[1], Cards(confirmation_tables([summary]), "stacked")]),
        points_note=f"The scenarios have seed {seeds[0]}{others}.",
        footer="All runs, one row each:",
    )


def write_study_report(summary: dict[str, Any], folder: StudyFolder) -> None:
    """Write the report of a study to its folder, and the library of its figures."""
    page = page_of(DrawnStudy(summary, folder.rerun_command))
    page = replace(page, footer_code=folder.rows_file.name)
    write_page(folder.report, page, shares_library=True)


def _with_failures(verdict: ReportHead, summary: dict[str, Any]) -> ReportHead:
    """The verdict with what kept runs from being judged."""
    failed = summary["runs_failed"]
    if not failed:
        return verdict
    said = replace(verdict, faults=[f"{failed} runs, most of them: {summary['commonest_error']}"])
    if failed < summary["runs"]:
        return said
    return replace(said, level="broken", headline="Every run failed")


def _shortened(seeds: Sequence[int]) -> str:
    texts = [str(seed) for seed in seeds]
    return ", ".join(texts) if len(texts) <= 6 else f"{len(texts)}: {texts[0]} … {texts[-1]}"
