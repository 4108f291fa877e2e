"""Margins as text."""

from __future__ import annotations

import math
from collections.abc import Sequence

from deploy.reports.studies.case_result import CaseResult, setting_text
from deploy.reports.studies.study_texts import listed, losses_text, value_text
from deploy.reports.tables import ABSENT
from deploy.studies.margin.result import Ends, MarginCase, MarginResult
from deploy.study.quoted import Because


def margin_text(case: Ends, result: MarginResult) -> str:
    """A margin with its unit; that it is beyond the limit, or that there is none."""
    if not case.completed:
        return "not known yet"
    if case.margin is None:
        return "none"
    beyond = "≥ " if case.growth > 0 else "≤ "
    sign = beyond if case.first_failure is None else ""
    return f"{sign}{value_text(case.margin, result)}"


def quoted_text(case: MarginCase, result: MarginResult) -> str:
    """The number to quote of a case, with its unit."""
    if not case.completed or case.because == Because.HELD:
        return margin_text(case, result)
    return "none" if case.quoted is None else value_text(case.quoted, result)


def because_text(case: MarginCase) -> str:
    """Explain why a smaller number than the held one is quoted; empty if the held one is."""
    because = case.quoted_because
    if because == Because.THEORY and case.quoted is None:
        return "unstable without a delay, in theory"
    words: dict[str, str] = {
        Because.THEORY: "unstable beyond it, in theory",
        Because.PATTERN: "a varying delay loses the bounds "
        + ("beyond it" if case.quoted is not None else "at every size tried"),
        Because.ROTORS: "with a tenth of the estimated rotors",
        Because.MODEL: f"with {_worst_model(case)}",
    }
    return words.get(because or "", "")


def _worst_model(case: MarginCase) -> str:
    """The model error with the smallest margin."""
    none = -math.inf
    least = min(
        case.model_errors,
        key=lambda each: none if each.margin is None else each.margin,
        default=None,
    )
    return "model" if least is None else least.change


def theory_text(case: MarginCase) -> str | None:
    """The largest constant delay that is stable in theory; None where theory knows none."""
    if case.theory is None or not case.theory.knows_windows:
        return None
    if case.theory.unstable_without_delay is not None:
        return "unstable"
    at_least = "" if case.theory.unstable_ms else "≥ "
    return f"{at_least}{case.theory.constant_ms:g} ms"


def unknowns_sentences(result: MarginResult) -> list[str]:
    """Name the unknowns of an arm of whose margins the smallest is quoted; nothing for none."""
    (case, *_) = result.cases
    rotors = ["a tenth of the estimated rotors"] if case.smaller_rotors else []
    tried = [*rotors, *(each.change for each in case.model_errors)]
    if not tried:
        return []
    searches = listed(["the arm as given", *tried])
    return [f"Each is the smallest of {1 + len(tried)} searches: {searches}."]


def pattern_text(case: MarginCase, result: MarginResult) -> str | None:
    """Up to where every pattern of delays holds: guaranteed, or with the number that was tried."""
    if case.guaranteed is not None:
        return value_text(case.guaranteed, result)
    if case.worst_pattern is None:
        return None
    return f"{value_text(case.worst_pattern.margin, result)}, {case.patterns.tried} tried"


def rotors_text(case: MarginCase, result: MarginResult) -> str | None:
    """The margin with a tenth of the estimated rotors; None if it was not searched."""
    found = case.smaller_rotors
    return None if found is None else margin_text(found, result)


def number_text(case: MarginCase, result: MarginResult) -> str:
    """The number to quote, with what the law has it, and why that is smaller than what held."""
    because = because_text(case)
    held = f"{margin_text(case, result)} as given" if because and case.margin is not None else ""
    why = "; ".join(filter(None, [because, held, untested_text(case)]))
    parts = (quoted_text(case, result), setting_text(case), why and f"({why})")
    return " ".join(filter(None, parts))


def untested_text(case: CaseResult) -> str:
    """Say beside a number that its runs do not show it; a sentence says why."""
    return "not tested" if case.doubts else ""


def furthest_case(cases: Sequence[MarginCase]) -> MarginCase:
    """The case with the furthest margin; one without a margin is behind all others."""
    return max(cases, key=_reached)


def least_case(cases: Sequence[MarginCase]) -> MarginCase:
    """The case with the least margin, or one without a margin."""
    return min(cases, key=_reached)


def _reached(case: MarginCase) -> float:
    return -math.inf if case.best_known is None else case.growth * case.best_known


def loss_text(case: MarginCase) -> str:
    """Explain why runs at the first failure left their funnel, and most often which joint."""
    failed = case.probe_at(case.first_failure)
    named = "" if failed is None else losses_text(failed)
    at_once = ", even at the smallest value tried" if case.margin is None else ""
    return f"{named}{at_once}" if named else ABSENT


def furthest(result: MarginResult) -> str:
    """Return the superlative of a margin: largest, or smallest where values shrink."""
    return "smallest" if any(case.growth < 0 for case in result.cases) else "largest"
