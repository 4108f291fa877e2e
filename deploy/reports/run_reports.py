"""Reports of runs: of one, of several laws, of recorded runs side by side.

Each says which figures, tables and facts stand on its page.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Any

from deploy.judge.conditions import Conditions
from deploy.judge.run_data import RunData
from deploy.reports import comparison_tables as of_runs
from deploy.reports import quantities
from deploy.reports import run_tables as of_run
from deploy.reports.page import Cards, Fact, Page, write_page
from deploy.reports.quantities import margin_place
from deploy.reports.run_panels import LAW_PANELS, RECORDED_PANELS, RUN_PANELS
from deploy.reports.tables import margin_text, number, percent
from deploy.reports.verdict import verdict_on_laws, verdict_on_run, verdict_on_runs
from deploy.run.execute import JudgedRun
from deploy.study.comparison.comparison import ComparedRuns
from deploy.study.comparison.recorded import RecordedRuns


def write_report(
    run: RunData,
    summary: dict[str, Any],
    path: Path,
    conditions: Mapping[str, str] = MappingProxyType({}),
) -> None:
    """Write the report of a run.

    Args:
        run: the run.
        summary: what `metrics.summarise` says of it.
        path: the HTML file to write.
        conditions: under which it came about.
    """
    from_s, bounds = run.setup.scenario.metrics.from_s, summary["bounds"]
    page = Page(
        "report of a run",
        f"{summary['scenario']} · {summary['law']}",
        verdict_on_run(run, summary, conditions),
        [
            *(Fact(key.capitalize(), summary[key]) for key in ("scenario", "law", "clock", "link")),
            Fact("Duration", f"{summary['duration_s']:g} s"),
            Fact("Smallest margin", margin_text(bounds["margin_min"]) + margin_place(bounds),
                 "1 − |e| / bound; negative outside the bounds"),
            Fact("Steady margin", margin_text(bounds["margin_steady"]),
                 f"the smallest from {from_s:g} s on, when the bounds have narrowed"),
            Fact(quantities.DEADLINES_MET, percent(summary["timing"]["success_rate"]),
                 "share of the ticks that met their deadline"),
            Fact("Digest", summary["digest"][:12], summary["digest"]),
        ],
        RUN_PANELS,
        ComparedRuns([JudgedRun(summary["law"], run, summary)]),
        conditions,
        before=("Key numbers", [
            Cards([of_run.joint_table(summary, from_s)]),
            Cards([of_run.timing_table(summary), of_run.health_table(summary),
                   of_run.transport_table(summary)], "three"),
            Cards([of_run.event_table(run)]),
            Cards(of_run.confirmation_tables([summary])),
        ]),
        end_s=summary["duration_s"],
        footer="Digest of the delivered joint states and commands (SHA-256):",
        footer_code=summary["digest"],
    )  # fmt: skip
    write_page(path, page)


def write_comparison_report(comparison: ComparedRuns, path: Path, conditions: Conditions) -> None:
    """Write the report of a comparison with at least one run to an HTML file.

    The library of its figures goes beside it, where reports of single laws find it too.
    """
    scenario, summary = comparison.runs[0].data.setup.scenario, comparison.runs[0].summary
    confirmed = of_run.confirmation_tables([run.summary for run in comparison.runs])
    page = Page(
        "comparison of control laws",
        summary["scenario"],
        verdict_on_laws(comparison),
        [
            Fact("Scenario", scenario.name),
            Fact("Laws", str(len(comparison.runs))),
            Fact("Duration", f"{scenario.duration_s:g} s"),
            Fact("Rate", number(scenario.rate_hz, 1.0, " Hz")),
            Fact("Seed", str(scenario.seed), "the same for all laws, like all other conditions"),
            Fact("Nominal model", f"× {scenario.controller.model_scale:g}",
                 "factor on masses and inertias of the nominal model"),
            Fact("Clock", summary["clock"]),
        ],
        LAW_PANELS,
        comparison,
        conditions,
        before=("Verdict", [Cards([of_runs.verdict_table(comparison)]), Cards(confirmed)]),
        after=("Joint by joint", [
            Cards([of_runs.law_table(comparison, each) for each in quantities.BY_LAW], "three"),
        ]),
        end_s=max(run.summary["duration_s"] for run in comparison.runs),
        footer=("Each law has its own folder beside this report, with its recording. This command"
               " writes the report of that run alone:"),
        footer_code="funnel-hil report",
    )  # fmt: skip
    write_page(path, page, shares_library=True)


def write_diff_report(compared: RecordedRuns, path: Path, conditions: Conditions) -> None:
    """Write the report of recorded runs side by side to an HTML file."""
    differences = [of_runs.difference_table(compared)] if compared.differing else []
    page = Page(
        "recorded runs side by side",
        " · ".join(compared.labels),
        verdict_on_runs(compared),
        [Fact(label, str(place))
         for label, place in zip(compared.labels, compared.paths, strict=True)],
        RECORDED_PANELS,
        compared,
        conditions,
        before=("Side by side", [
            Cards([of_runs.recorded_table(compared), *differences], "stacked"),
            Cards(of_runs.recorded_joint_tables(compared), "three"),
            Cards([of_runs.recorded_timing_table(compared)], "stacked"),
        ]),
        footer="Each run was evaluated again from its recording, with its own scenario's funnel.",
    )  # fmt: skip
    write_page(path, page)
