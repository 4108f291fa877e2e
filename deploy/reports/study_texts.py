"""What the cases and values of sweeps and margins are called, and their results in words."""

from __future__ import annotations

from typing import Any

from deploy.reports.tables import ABSENT, Column

Summary = dict[str, Any]

COMPENSATION = {None: "", False: "without", True: "with"}


def setting_text(case: Summary) -> str:
    """With what a law has a margin: compensation, feedback at the drives, a loop that runs."""
    running = ["running"] if case["running"] else []
    return ", ".join([*filter(None, [equipment_text(case)]), *running])


def equipment_text(case: Summary) -> str:
    """With or without compensation, and feedback at the drives."""
    said = [
        f"{COMPENSATION[case['compensation']]} compensation",
        f"{COMPENSATION[case['drive_feedback']]} drive feedback",
    ]
    return ", ".join(text for text in said if not text.startswith(" "))


def case_name(case: Summary) -> str:
    """What a margin is of: the law, and with what."""
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
    """What grows, with its unit."""
    return Column(summary["title"], summary["unit"]).title


def interval_text(share: Summary) -> str:
    """Wilson's interval of a share in per cent."""
    if share["wilson_95"] is None:
        return ABSENT
    low, high = (100 * end for end in share["wilson_95"])
    return f"{low:.0f}–{high:.0f} %"


def share_text(share: Summary) -> str:
    """How many of how many were kept."""
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


def probe_at(case: Summary, value: float | None) -> Summary | None:
    """What became of a value that was tried."""
    return next((probe for probe in case["probes"] if probe["value"] == value), None)


def sentences(summary: Summary) -> list[str]:
    """The results of a study of margins in words, the best first; none for a sweep."""
    if summary["kind"] == "margin":
        return [*_headlines(summary), *_held_again(summary)]
    cases = sorted(summary.get("cases", ()), key=lambda case: case["kept_up_to"] or -1.0)
    return [_kept_sentence(case, summary) for case in reversed(cases)]


def _headlines(summary: Summary) -> list[str]:
    """Who takes the most on each arm: first of loops that run, then of those that start so."""
    arms = dict.fromkeys(case["arm"] for case in summary["cases"])
    return [
        _best(summary, own, arm)
        for arm in arms
        for running in (True, False)
        if (own := [c for c in summary["cases"] if (c["arm"], c["running"]) == (arm, running)])
    ]


def _best(summary: Summary, cases: list[Summary], arm: str) -> str:
    """Who takes the most of the cases of an arm."""
    known = [case for case in cases if case["margin"] is not None]
    where = f"{arm}, a loop that already runs" if cases[0]["running"] else arm
    if not known:
        return f"{where}: no law keeps its bounds at all."
    best = max(known, key=lambda case: case["growth"] * case["margin"])
    laws: dict[str, list[str]] = {}
    for case in known:
        if case["margin"] == best["margin"]:
            laws.setdefault(equipment_text(case), []).append(case["law"])
    whose = [f"{_listed(names)} {equipment}".rstrip() for equipment, names in laws.items()]
    margin = f"{furthest(summary)} margin is {margin_text(best, summary)}"
    return f"{where}: the {margin}, of {'; of '.join(whose)}."


def _listed(names: list[str]) -> str:
    return " and ".join(filter(None, [", ".join(names[:-1]), names[-1]]))


def _held_again(summary: Summary) -> list[str]:
    """A sentence for each case that kept its bounds once more beyond its first failure."""
    return [
        f"{case_title(case)}: held again at"
        f" {', '.join(f'{value:g}' for value in case['held_again'])}, beyond its first failure."
        for case in summary["cases"]
        if case["held_again"]
    ]


def furthest(summary: Summary) -> str:
    """What a margin is of the values that held: the largest, or where values shrink the least."""
    return "smallest" if any(case["growth"] < 0 for case in summary["cases"]) else "largest"


def kept_text(case: Summary, summary: Summary) -> str:
    """Up to where enough plants are kept, with the interval of their share there."""
    at = _kept_last(case)
    if at is None:
        is_judged = case["values"][0]["total"] == summary["plants"]
        return "none" if is_judged else "not known yet"
    return f"{value_text(at['value'], summary)} ({interval_text(at)})"


def _kept_last(case: Summary) -> Summary | None:
    """The largest value up to which enough plants are kept, with what became of them there."""
    return next((at for at in case["values"] if at["value"] == case["kept_up_to"]), None)


def _kept_sentence(case: Summary, summary: Summary) -> str:
    at, share = _kept_last(case), f"{100 * summary['kept_share']:g} %"
    if at is None:
        return f"{case_title(case)}: at no value {share} of {summary['plants']} plants kept bounds"
    kept = f"{share_text(at)} plants kept their bounds up to {value_text(at['value'], summary)}"
    return f"{case_title(case)}: {kept}; of all such plants {interval_text(at)} (95 % interval)"
