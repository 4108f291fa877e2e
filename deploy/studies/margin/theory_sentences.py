"""Margins in theory, in sentences."""

from __future__ import annotations

from deploy.reports.studies.case_result import case_title
from deploy.reports.studies.study_texts import listed
from deploy.studies.margin.result import MarginCase, MarginResult, Theory
from deploy.studies.margin.texts import loss_text


def theory_sentences(summary: MarginResult) -> list[str]:
    """Theoretical margins, a sentence per case; and the reasons why other cases have none."""
    reasons = dict[str, list[str]]()
    for case in summary.cases:
        if case.theory is not None and case.theory.reason is not None:
            reasons.setdefault(case.theory.reason, []).append(case.law)
    return in_theory(summary) + [
        f"No theoretical margin for {listed([*dict.fromkeys(names)])}: {reason}."
        for reason, names in reasons.items()
    ]


def in_theory(summary: MarginResult) -> list[str]:
    """Return the theoretical margins, a sentence per case that has one."""
    return [
        f"{case_title(case)}: {_lost_at_once(case)}in theory {_stability(theory)}"
        f"{_windows(theory.unstable_ms)}."
        for case in summary.cases
        if (theory := case.theory) is not None and theory.reason is None
    ]


def _lost_at_once(case: MarginCase) -> str:
    """Return the reason why a case is lost at its first value, to go before theory's."""
    return f"{loss_text(case)}; " if case.completed and case.margin is None else ""


def _stability(theory: Theory) -> str:
    if (growth := theory.unstable_without_delay) is not None:  # older ones lack it
        hertz = growth.frequency_hz
        swings = f"at {hertz:g} Hz" if hertz else "without swinging"
        return (
            f"unstable without a delay: it grows by {growth.rate_per_s:g}/s {swings}"
            f" ({_OF_THEORY}; {growth.joint} moves most)"
        )
    weakest = f"; weakest: {theory.joint}" if theory.joint else ""
    return (
        f"stable with every constant round trip up to {theory.constant_ms:g} ms, and with every"
        f" varying one below {theory.any_pattern_ms:g} ms ({_OF_THEORY}{weakest})"
    )


_OF_THEORY = "linear, the arm at its start, viscous friction alone"
_SHOWN_WINDOWS = 3


def _windows(unstable_ms: list[list[float | None]] | None) -> str:
    """Return the windows of unstable delays in words, if a larger delay is stable again."""
    if not unstable_ms or unstable_ms[0][1] is None:
        return ""
    shown = ", ".join(
        f"{begin:g} ms on" if end is None else f"{begin:g} to {end:g} ms"
        for begin, end in unstable_ms[:_SHOWN_WINDOWS]
    )
    count = len(unstable_ms)
    more = f", and so on ({count} windows)" if count > _SHOWN_WINDOWS else ""
    return f"; unstable from {shown}{more}"
