"""Names of the cases and values of sweeps and margins, and their numbers as text."""

from __future__ import annotations

import math
from collections import Counter
from typing import Any

from deploy.reports.tables import ABSENT, Column
from deploy.study.quoted import Because

Summary = dict[str, Any]

COMPENSATION = {None: "", False: "without", True: "with"}


def setting_text(case: Summary) -> str:
    """With what a law has a margin: compensation, feedback at the drives, a loop that runs."""
    running = ["running"] if case["running"] else []
    return ", ".join([*filter(None, [equipment_text(case)]), *running])


def equipment_text(case: Summary) -> str:
    """With or without compensation, and feedback at the drives."""
    sentences = [
        f"{COMPENSATION[case['compensation']]} compensation",
        f"{COMPENSATION[case['drive_feedback']]} drive feedback",
    ]
    return ", ".join(text for text in sentences if not text.startswith(" "))


def case_name(case: Summary) -> str:
    """Return the name of a margin's case: the law and its equipment."""
    return f"{case['law']} {setting_text(case)}".rstrip()


def case_title(case: Summary) -> str:
    """The same with its arm."""
    return f"{case['arm']}, {case_name(case)}"


def ceiling_text(case: Summary) -> str | None:
    """The held-arm ceiling of a case, as far as there is one."""
    ceiling = case["held_arm_ceiling_ms"]
    return None if ceiling is None else f"{ceiling:.0f} ms"


def value_text(value: float, summary: Summary) -> str:
    """A value with its unit."""
    return f"{value:g} {summary['unit']}".rstrip()


def value_title(summary: Summary) -> str:
    """Return the name of the growing quantity, with its unit."""
    return Column(summary["title"], summary["unit"]).title


def interval_text(share: Summary) -> str:
    """The 95 % interval of a share in per cent: Wilson's, or that of a sequential test."""
    interval = share.get("interval_95", share["wilson_95"])
    if interval is None:
        return ABSENT
    low, high = (100 * end for end in interval)
    return f"{low:.0f}–{high:.0f} %"


def share_text(share: Summary) -> str:
    """Return the number kept of the number judged."""
    return f"{share['kept']} of {share['total']}" if share["total"] else ABSENT


def margin_figure(case: Summary) -> str:
    """A margin without its unit; that it is beyond the limit, or that there is none."""
    if not case["completed"]:
        return "not known yet"
    if case["margin"] is None:
        return "none"
    beyond = "≥ " if case["growth"] > 0 else "≤ "
    sign = beyond if case["first_failure"] is None else ""
    return f"{sign}{case['margin']:g}"


def margin_text(case: Summary, summary: Summary) -> str:
    """A margin with its unit."""
    has_unit = case["completed"] and case["margin"] is not None
    return f"{margin_figure(case)} {summary['unit'] if has_unit else ''}".rstrip()


def quoted_text(case: Summary, summary: Summary) -> str:
    """The number to quote of a case, with its unit."""
    if not case["completed"] or case.get("quoted_because", Because.HELD) == Because.HELD:
        return margin_text(case, summary)
    number = case["quoted"]
    return "none" if number is None else value_text(number, summary)


def quoted_or_none(case: Summary) -> float | None:
    """The number to quote of a case; older results have only their margin."""
    found: float | None = case.get("quoted", case["margin"])
    return found


def because_text(case: Summary) -> str:
    """Explain why a smaller number than the held one is quoted; empty if the held one is."""
    because = case.get("quoted_because")
    if because == Because.THEORY and case["quoted"] is None:
        return "unstable without a delay, in theory"
    words: dict[str, str] = {
        Because.THEORY: "unstable beyond it, in theory",
        Because.PATTERN: "a pattern of delays is lost beyond it",
        Because.ROTORS: "with a tenth of the estimated rotors",
        Because.MODEL: f"with {_worst_model(case)}",
    }
    return words.get(because or "", "")


def _worst_model(case: Summary) -> str:
    """The model error with the smallest margin."""
    errors = case.get("model_errors") or [{"change": "model", "margin": None}]
    none = -math.inf
    least = min(errors, key=lambda each: none if each["margin"] is None else each["margin"])
    return str(least["change"])


def theory_text(case: Summary) -> str | None:
    """The largest constant delay that is stable in theory; None where theory knows none."""
    theory = case.get("theory") or {}
    if theory.get("unstable_without_delay") is not None:
        return "unstable"
    return f"{theory['constant_ms']:g} ms" if "constant_ms" in theory else None


def unknowns_text(summary: Summary) -> str:
    """Name the unknowns of an arm that were tried at their worst; empty for none."""
    (case, *_) = summary["cases"]
    errors = [each["change"] for each in case.get("model_errors") or ()]
    rotors = ["a tenth of the estimated rotors"] if case.get("smaller_rotors") else []
    tried = [*rotors, *errors]
    return f", the worst of the exact arm, {', '.join(tried)}" if tried else ""


def pattern_text(case: Summary, summary: Summary) -> str | None:
    """Up to where every pattern of delays holds: guaranteed, or with the number that was tried."""
    if case.get("guaranteed") is not None:
        return value_text(case["guaranteed"], summary)
    if (worst := case.get("worst_pattern")) is None:
        return None
    return f"{value_text(worst['margin'], summary)}, {case['patterns']['tried']} tried"


def rotors_text(case: Summary, summary: Summary) -> str | None:
    """The margin with a tenth of the estimated rotors; None if it was not searched."""
    found = case.get("smaller_rotors")
    return None if found is None else margin_text(found, summary)


def probe_at(case: Summary, value: float | None) -> Summary | None:
    """Return the result at a value that was tried."""
    return next((probe for probe in case["probes"] if probe["value"] == value), None)


def setting_and_reason(case: Summary) -> str:
    """With what a law has the number to quote, and why that is smaller than what held."""
    reason = because_text(case)
    return f"{setting_text(case)} ({reason})".lstrip() if reason else setting_text(case)


def furthest_case(cases: list[Summary]) -> Summary:
    """The case with the furthest margin; one without a margin is behind all others."""

    def reached(case: Summary) -> float:
        number = quoted_or_none(case)
        return -math.inf if number is None else case["growth"] * number

    return max(cases, key=reached)


def listed(names: list[str]) -> str:
    """Return names as in a sentence."""
    return " and ".join(filter(None, [", ".join(names[:-1]), names[-1]]))


def losses_text(runs: Summary) -> str:
    """Explain why runs left their funnel, the most frequent reason first, with their joint."""
    losses, joints = (Counter(runs.get(key) or {}) for key in ("losses", "loss_joints"))
    return ", ".join(name for name, _ in (*losses.most_common(), *joints.most_common(1)))


def loss_text(case: Summary) -> str:
    """Explain why runs at the first failure left their funnel, and most often which joint."""
    named = losses_text(probe_at(case, case["first_failure"]) or {})
    return f"{named}, already without it" if named and case["margin"] is None else named or ABSENT


def furthest(summary: Summary) -> str:
    """Return the superlative of a margin: largest, or smallest where values shrink."""
    return "smallest" if any(case["growth"] < 0 for case in summary["cases"]) else "largest"


def kept_text(case: Summary, summary: Summary) -> str:
    """Up to where enough plants are kept, with the interval of their share there."""
    at = kept_last(case)
    if at is None:
        return "not known yet" if case["values"][0].get("tolerated", False) is None else "none"
    return f"{value_text(at['value'], summary)} ({interval_text(at)})"


def kept_last(case: Summary) -> Summary | None:
    """The largest value up to which enough plants are kept, with what became of them there."""
    return next((at for at in case["values"] if at["value"] == case["kept_up_to"]), None)
