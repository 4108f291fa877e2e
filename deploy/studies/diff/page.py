"""The page of recorded runs side by side."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING

from deploy.judge.conditions import Conditions
from deploy.reports.page import Cards, Fact, Page
from deploy.reports.runs.run_pages import folded_title, panels_of
from deploy.studies.diff import tables as of_runs
from deploy.studies.diff.sentences import verdict_on_runs
from deploy.study.comparison.compared_runs import ComparedRuns

if TYPE_CHECKING:
    from deploy.study.comparison.recorded import RecordedRuns


def diff_page(compared: RecordedRuns, conditions: Conditions) -> Page[ComparedRuns]:
    """Return the page of recorded runs side by side."""
    differences = [of_runs.difference_table(compared)] if compared.differing else []
    return Page(
        "recorded runs side by side",
        " · ".join(compared.labels),
        verdict_on_runs(compared),
        [Fact(label, str(place))
         for label, place in zip(compared.labels, compared.paths, strict=True)],
        partial(panels_of, "RECORDED_PANELS"),
        compared,
        conditions,
        results=[
            Cards([of_runs.recorded_table(compared), *differences], "stacked"),
            Cards(of_runs.recorded_joint_tables(compared), "three"),
        ],
        folded=(folded_title([run.result for run in compared.runs]), [
            Cards([of_runs.recorded_timing_table(compared), of_runs.recorded_counts(compared)],
                  "stacked"),
        ]),
        footer="Each run was evaluated again from its recording, with its own scenario's funnel.",
    )  # fmt: skip
