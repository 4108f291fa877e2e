"""Shares of uncertain plants in sentences."""

from __future__ import annotations

from collections.abc import Mapping

from deploy.reports.studies.case_result import case_title
from deploy.reports.studies.case_sentences import doubts, saved_runs
from deploy.reports.studies.study_texts import interval_text, share_text, value_text
from deploy.studies.robustness.result import RobustCase, RobustnessResult


def robustness_sentences(summary: RobustnessResult) -> list[str]:
    """Return how many plants were kept, in words, the best case first."""
    cases = sorted(summary.cases, key=lambda case: case.kept_up_to or -1.0)
    kept = [_kept_sentence(case, summary) for case in reversed(cases)]
    tests = map(_test, filter(None, [summary.test]))
    return [*kept, *tests, *saved_runs(summary), *doubts(summary.cases)]


def _test(test: Mapping[str, float]) -> str:
    """Name the errors with which a sequential test decides."""
    poor, passes, good, fails = (f"{100 * value:.1f} %" for value in test.values())
    return (
        "Plants are run at each value until a sequential test decides. Its errors: a value that"
        f" only {poor} of all such plants tolerate passes in {passes} of the cases, one that {good}"
        f" tolerate fails in {fails}."
    )


def _kept_sentence(case: RobustCase, summary: RobustnessResult) -> str:
    at, share = case.kept_last, f"{100 * summary.kept_share:g} %"
    if at is None:
        first = case.values[0]
        tried = f"at {value_text(first.value, summary)}, the smallest value tried"
        found = f"{share_text(first)} plants kept their bounds ({share} are wanted)"
        return f"{case_title(case)}: {tried}, {found}; {_next_trial(case, summary)}"
    kept = f"{share_text(at)} plants kept their bounds up to {value_text(at.value, summary)}"
    untested = " (not tested)" if case.doubts else ""
    of_all = f"of all such plants {interval_text(at)} (95 % interval)"
    return f"{case_title(case)}: {kept}{untested}; {of_all}"


def _next_trial(case: RobustCase, summary: RobustnessResult) -> str:
    """Name a change that may find plants that are kept, where at no value enough are."""
    first, *later = case.values
    if first.value == 0 or any(
        (at.fraction or 0.0) >= (first.fraction or 0.0) > 0.0 for at in later
    ):
        other = "compare other laws, or allow wider bounds (funnel)"
        return f"the {summary.title} is not what loses the others: {other}"
    helps = summary.quantity == "delay" and not case.compensation
    return "try smaller --values" + (", or --compensation on" if helps else "")


def kept_text(case: RobustCase, summary: RobustnessResult) -> str:
    """Up to where enough plants are kept, with the interval of their share there."""
    at = case.kept_last
    if at is None:
        return "not known yet" if case.values[0].tolerated is None else "none"
    return f"{value_text(at.value, summary)} ({interval_text(at)})"
