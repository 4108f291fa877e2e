"""Shares of uncertain plants in sentences."""

from __future__ import annotations

from deploy.reports.studies.case_sentences import doubts, saved_runs
from deploy.reports.studies.study_texts import (
    Summary,
    case_title,
    interval_text,
    kept_last,
    share_text,
    value_text,
)


def robustness_sentences(summary: Summary) -> list[str]:
    """Return how many plants were kept, in words, the best case first."""
    cases = sorted(summary["cases"], key=lambda case: case["kept_up_to"] or -1.0)
    kept = [_kept_sentence(case, summary) for case in reversed(cases)]
    tests = map(_test, filter(None, [summary.get("test")]))
    return [*kept, *tests, *saved_runs(summary), *doubts(summary)]


def _test(test: Summary) -> str:
    """Name the errors with which a sequential test decides."""
    poor, passes, good, fails = (f"{100 * value:.1f} %" for value in test.values())
    return (
        f"Sequential test at each value: if {poor} of all plants were kept, the value would count"
        f" as tolerated with a probability of {passes}; if {good} were, it would not with {fails}."
    )


def _kept_sentence(case: Summary, summary: Summary) -> str:
    at, share = kept_last(case), f"{100 * summary['kept_share']:g} %"
    if at is None:
        return f"{case_title(case)}: at no value {share} of {summary['plants']} plants kept bounds"
    kept = f"{share_text(at)} plants kept their bounds up to {value_text(at['value'], summary)}"
    return f"{case_title(case)}: {kept}; of all such plants {interval_text(at)} (95 % interval)"
