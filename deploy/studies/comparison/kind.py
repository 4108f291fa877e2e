"""The kind of result `comparison`: its result in a list is that of its worst law."""

from __future__ import annotations

from deploy.judge.verdict import Verdict
from deploy.reports.kinds import COMPLETE, OLDER, ResultKind, Summary, completeness, run_verdict
from deploy.studies.comparison.comparison import LawComparison
from deploy.studies.comparison.result import ComparisonResult
from deploy.studies.comparison.results import judged, laws_again
from deploy.study.comparison.compared_runs import KIND as NAME

_WORST = (
    OLDER,
    *(each.listed for each in (Verdict.INTERRUPTED, Verdict.NOTHING, Verdict.FAULTED)),
)


def _worst_law(summary: Summary) -> str:
    laws = summary.get("laws")
    if not isinstance(laws, dict):
        return completeness(summary)
    found = {run_verdict(law) for law in laws.values() if isinstance(law, dict)}
    return next((each for each in _WORST if each in found), COMPLETE)


KIND = ResultKind(
    NAME, ComparisonResult, LawComparison, judged=judged, again=laws_again, listed=_worst_law
)
