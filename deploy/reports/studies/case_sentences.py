"""Sentences about cases: the runs that were saved, and reasons for doubt."""

from __future__ import annotations

from collections.abc import Sequence

from deploy.reports.studies.case_result import Case, CaseResult, CasesResult, case_title

_NOT_WORTH_A_WORD = 0.995


def saved_runs(summary: CasesResult[Case]) -> list[str]:
    """Name the runs and the simulated time that were enough; nothing if that was all."""
    saved = summary.saved
    if not saved or saved.simulated_s >= _NOT_WORTH_A_WORD * saved.planned_s:
        return []
    share = 100 * saved.simulated_s / saved.planned_s
    early = saved.runs_ended_early
    ended = f"; {early} of them ended at their loss" if early else ""
    return [
        f"{summary.runs} of {saved.runs_planned} planned runs decided the result{ended}."
        f" They took {share:.0f} % of the planned simulated time."
    ]


def doubts(cases: Sequence[CaseResult]) -> list[str]:
    """A sentence for each reason why the runs of cases do not show their margins."""
    names: dict[str, list[str]] = {}
    for case in cases:
        for doubt in case.doubts:
            names.setdefault(doubt, []).append(case_title(case))
    return [f"Not tested: {doubt} ({'; '.join(named)})." for doubt, named in names.items()]
