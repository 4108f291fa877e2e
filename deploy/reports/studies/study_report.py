"""Reports of sweeps and margins, made of their summaries alone."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

from deploy.reports import plotly_library
from deploy.reports.confirmation_table import confirmation_tables
from deploy.reports.page import Fact, write_page
from deploy.reports.studies.margin_report import margin_content
from deploy.reports.studies.robustness_report import robustness_content
from deploy.reports.studies.study_content import Study, StudyContent
from deploy.reports.studies.sweep_report import sweep_content
from deploy.reports.verdict import ReportHead
from deploy.study.folder import StudyFolder

_CONTENTS = {"sweep": sweep_content, "margin": margin_content, "robustness": robustness_content}


def content_of(summary: dict[str, Any]) -> StudyContent:
    """What the report of a study says, from its summary."""
    return _CONTENTS[summary["kind"]](summary)


def write_study_report(summary: dict[str, Any], folder: StudyFolder) -> None:
    """Write the report of a sweep or of margins to its folder, and the library of its figures."""
    content = content_of(summary)
    content = replace(content, results=[*content.results, *confirmation_tables([summary])])
    verdict = _with_failures(content.verdict, summary)
    runs = f"{summary['runs']}" if summary["completed"] else f"{summary['runs']}, not complete"
    plotly_library.share(folder.path)
    write_page(
        folder.report,
        "study.html",
        content.panels if summary["runs"] else (),
        Study(summary, folder.rerun_command),
        title=f"{summary['name']} · {verdict.headline}",
        verdict=verdict,
        facts=[
            *content.facts,
            Fact("Runs", runs),
            Fact("Failed runs", str(summary["runs_failed"])),
            Fact("Seeds", _shortened(summary["seeds"])),
        ],
        conditions=summary.get("conditions", {}),
        study=content,
        summary=summary,
        folder=folder,
    )


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
