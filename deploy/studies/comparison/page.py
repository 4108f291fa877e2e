"""The page of a comparison."""

from __future__ import annotations

from functools import partial

from deploy.judge.conditions import Conditions
from deploy.reports.page import Cards, Fact, Page
from deploy.reports.runs import run_numbers
from deploy.reports.runs import run_tables as of_run
from deploy.reports.runs.run_pages import folded_title, panels_of
from deploy.reports.tables import number
from deploy.studies.comparison import tables as of_runs
from deploy.studies.comparison.sentences import verdict_on_laws
from deploy.study.comparison.compared_runs import ComparedRuns


def laws_page(comparison: ComparedRuns, conditions: Conditions) -> Page[ComparedRuns]:
    """Return the page of a comparison with at least one run."""
    scenario, result = comparison.runs[0].data.setup.scenario, comparison.runs[0].result
    confirmed = of_run.confirmation_tables(run.result.confirmation for run in comparison.runs)
    return Page(
        "comparison of control laws",
        result.scenario,
        verdict_on_laws(comparison),
        [
            Fact("Scenario", scenario.name),
            Fact("Laws", str(len(comparison.runs))),
            Fact("Duration", f"{scenario.duration_s:g} s"),
            Fact("Rate", number(scenario.rate_hz, 1.0, " Hz")),
            Fact("Seed", str(scenario.seed), "the same for all laws, like all other conditions"),
            Fact("Nominal model", f"× {scenario.controller.model_scale:g}",
                 "factor on masses and inertias of the nominal model"),
            Fact("Clock", result.clock),
        ],
        partial(panels_of, "LAW_PANELS"),
        comparison,
        conditions,
        results=[
            Cards([of_runs.verdict_table(comparison)]), Cards(confirmed),
            Cards([of_runs.law_table(comparison, each) for each in run_numbers.BY_LAW], "three"),
        ],
        folded=(folded_title([run.result for run in comparison.runs]), []),
        end_s=max(run.result.duration_s for run in comparison.runs),
        footer=("Each law has its own folder beside this report, with its recording. This command"
               " writes the report of that run alone:"),
        footer_code="funnel-hil report",
        shares_library=True,
    )  # fmt: skip
