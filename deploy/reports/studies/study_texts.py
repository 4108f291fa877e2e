"""Names of the cases and values of sweeps and margins, and their results in words."""

from __future__ import annotations

import math
from collections import Counter
from typing import Any

from deploy.reports.tables import ABSENT, Column
from deploy.scenario.playout import EXPECTED
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


def _pattern_sentence(case: Summary, summary: Summary) -> str | None:
    """Describe a case under delays that vary."""
    if case.get("guaranteed"):
        playout, remedy = _playout_texts(case)
        return (
            f"{case_title(case)}: holds for every delay up to"
            f" {value_text(case['guaranteed'], summary)} that arrives in order and is not lost,"
            f" with {playout}; the motion is the same to the bit in"
            f" {case['patterns']['tried']} patterns.{remedy}"
        )
    if (worst := case.get("worst_pattern")) is None:
        return None
    name = ", ".join(f"{key} {value}" for key, value in worst["pattern"].items())
    return (
        f"{case_title(case)}: every pattern of delays: {pattern_text(case, summary)}. The worst, at"
        f" {value_text(worst['value'], summary)}: {name}."
    )


def _playout_texts(case: Summary) -> tuple[str, str]:
    """For which play-out time d a guarantee holds; how to set it where the scenario does not."""
    if (d_ms := case.get("guaranteed_d_ms")) is None:  # of an older version
        return "the play-out of the constant delay", ""
    playout = f"a play-out of d = {d_ms:.9g} ms"
    if case["guaranteed_command"] is None:
        return playout, ""
    own = f" The scenario's own link gives d = {case['scenario_d_ms']:.9g} ms at the start"
    return playout, f"{own}: add --set {EXPECTED}={d_ms:.9g}."


def probe_at(case: Summary, value: float | None) -> Summary | None:
    """Return the result at a value that was tried."""
    return next((probe for probe in case["probes"] if probe["value"] == value), None)


def margin_headline(summary: Summary) -> str:
    """The margins of the best law in one sentence: of each arm without and with compensation.

    Of more than two settings it has the best.
    """
    cases, texts = summary["cases"], []
    laws, arms = (list(dict.fromkeys(case[key] for case in cases)) for key in ("law", "arm"))
    for arm in arms:
        settings: dict[str, list[Summary]] = {}
        for case in cases:
            if case["arm"] == arm:
                settings.setdefault(setting_text(case), []).append(case)
        best = list(map(furthest_case, settings.values()))
        shown = best if len(best) <= 2 else [furthest_case(best)]
        margins = (f"{quoted_text(case, summary)} {setting_and_reason(case)}" for case in shown)
        texts.append(f"{f'{arm} ' if arms[1:] else ''}{', '.join(map(str.rstrip, margins))}")
    who = f"the best of {len(laws)} laws" if laws[1:] else laws[0]
    kept = f"{furthest(summary).capitalize()} {summary['title']} kept by {who}{model_text(cases)}"
    return f"{kept}: {'; '.join(texts)}"


def setting_and_reason(case: Summary) -> str:
    """With what a law has the number to quote, and why that is smaller than what held."""
    reason = because_text(case)
    return f"{setting_text(case)} ({reason})".lstrip() if reason else setting_text(case)


def model_text(cases: list[Summary]) -> str:
    """Describe how the model that compensation predicts with differs from the arm."""
    compensated = (case for case in cases if case["compensation"])
    scales = {case["model_scale"] for case in compensated if "model_scale" in case}
    if scales <= {1.0}:
        return ", if the arm is known exactly" * bool(scales)
    return f", with a model of {' or '.join(f'{each:g}' for each in sorted(scales))} × its masses"


def furthest_case(cases: list[Summary]) -> Summary:
    """The case with the furthest margin; one without a margin is behind all others."""

    def reached(case: Summary) -> float:
        number = quoted_or_none(case)
        return -math.inf if number is None else case["growth"] * number

    return max(cases, key=reached)


def margin_sentences(summary: Summary) -> list[str]:
    """Return margins in words, the best first."""
    patterns = filter(None, (_pattern_sentence(case, summary) for case in summary["cases"]))
    found = [*_headlines(summary), *patterns, *_held_again(summary), *_flawed(summary)]
    rotors = [
        f"{case_title(case)}: the rotors are estimated: {margin_text(case, summary)};"
        f" {smaller} if the rotors are a tenth."
        for case in summary["cases"]
        if (smaller := rotors_text(case, summary))
    ]
    limits = [*_gaps(summary), *_too_slow(summary)]
    return [*found, *rotors, *theory_sentences(summary), *limits, *_saved(summary)]


def brief_margin_sentences(summary: Summary) -> list[str]:
    """Return margins in words, without what a table beside them says."""
    patterns = filter(None, (_pattern_sentence(case, summary) for case in summary["cases"]))
    found = [*_doubts(summary), *patterns]
    in_theory = [*_in_theory(summary), *_gaps(summary), *_too_slow(summary)]
    return [*found, *_held_again(summary), *in_theory]


def robustness_sentences(summary: Summary) -> list[str]:
    """Return how many plants were kept, in words, the best case first."""
    cases = sorted(summary["cases"], key=lambda case: case["kept_up_to"] or -1.0)
    kept = [_kept_sentence(case, summary) for case in reversed(cases)]
    tests = map(_test, filter(None, [summary.get("test")]))
    return [*kept, *tests, *_saved(summary), *_doubts(summary)]


_NOT_WORTH_A_WORD = 0.995


def _saved(summary: Summary) -> list[str]:
    """Name the runs and the simulated time that were enough; nothing if that was all."""
    saved = summary.get("saved")
    if not saved or saved["simulated_s"] >= _NOT_WORTH_A_WORD * saved["planned_s"]:
        return []
    share = 100 * saved["simulated_s"] / saved["planned_s"]
    return [
        f"{summary['runs']} of {saved['runs_planned']} planned runs were needed, and"
        f" {saved['runs_ended_early']} stopped after their loss: {share:.0f} % of the planned"
        " simulated time."
    ]


def _test(test: Summary) -> str:
    """Name the errors with which a sequential test decides."""
    poor, passes, good, fails = (f"{100 * value:.1f} %" for value in test.values())
    return (
        f"Sequential test at each value: if {poor} of all plants were kept, the value would count"
        f" as tolerated with a probability of {passes}; if {good} were, it would not with {fails}."
    )


def _headlines(summary: Summary) -> list[str]:
    """Name the best case on each arm: first of loops that run, then of those that start so."""
    arms = dict.fromkeys(case["arm"] for case in summary["cases"])
    return [
        _best(summary, own, arm)
        for arm in arms
        for running in (True, False)
        if (own := [c for c in summary["cases"] if (c["arm"], c["running"]) == (arm, running)])
    ]


def _best(summary: Summary, cases: list[Summary], arm: str) -> str:
    """Name the case of an arm that takes the most."""
    known = [case for case in cases if quoted_or_none(case) is not None]
    where = f"{arm}, a loop that already runs" if cases[0]["running"] else arm
    if not known:
        return f"{where}: no law keeps its bounds at all."
    best = furthest_case(known)
    laws: dict[str, list[str]] = {}
    for case in known:
        if quoted_or_none(case) == quoted_or_none(best):
            laws.setdefault(equipment_text(case), []).append(case["law"])
    whose = [f"{_listed(names)} {equipment}".rstrip() for equipment, names in laws.items()]
    reason = because_text(best)
    margin = f"{furthest(summary)} margin is {quoted_text(best, summary)}"
    margin += f" ({reason})" if reason else ""
    return f"{where}: the {margin}, of {'; of '.join(whose)}." + "".join(
        f" {text}" for text in _doubts({"cases": cases})
    )


def _doubts(summary: Summary) -> list[str]:
    """A sentence for each reason why the runs of cases do not show their margins."""
    names: dict[str, list[str]] = {}
    for case in summary.get("cases", ()):
        for doubt in case.get("doubts", ()):
            names.setdefault(doubt, []).append(case_title(case))
    return [f"Not tested: {doubt} ({'; '.join(cases)})." for doubt, cases in names.items()]


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


_FLAWS = {
    "runs_growing": "an error grows exponentially in {} of {} runs: this loop is unstable",
    "runs_vibrating": "a torque swings between its limits in {} of {} runs: this loop vibrates",
}
"""What is said of runs that do not hold although they kept their bounds."""


def _flawed(summary: Summary) -> list[str]:
    """A sentence for each case whose margin ends where a loop grows or vibrates in its bounds."""
    return [
        f"{case_title(case)}: at {value_text(probe['value'], summary)}"
        f" {words.format(probe[name], probe['runs'])}."
        for case in summary["cases"]
        if (probe := probe_at(case, case["first_failure"]))
        for name, words in _FLAWS.items()
        if probe.get(name)
    ]


def losses_text(runs: Summary) -> str:
    """Explain why runs left their funnel, the most frequent reason first, with their joint."""
    losses, joints = (Counter(runs.get(key) or {}) for key in ("losses", "loss_joints"))
    return ", ".join(name for name, _ in (*losses.most_common(), *joints.most_common(1)))


def loss_text(case: Summary) -> str:
    """Explain why runs at the first failure left their funnel, and most often which joint."""
    named = losses_text(probe_at(case, case["first_failure"]) or {})
    return f"{named}, already without it" if named and case["margin"] is None else named or ABSENT


def theory_sentences(summary: Summary) -> list[str]:
    """Theoretical margins, a sentence per case; and the reasons why other cases have none."""
    reasons = dict[str, list[str]]()
    for case in summary["cases"]:
        if "reason" in (theory := case.get("theory") or {}):
            reasons.setdefault(theory["reason"], []).append(case["law"])
    return _in_theory(summary) + [
        f"No theoretical margin, because {reason}: {_listed([*dict.fromkeys(names)])}."
        for reason, names in reasons.items()
    ]


def _in_theory(summary: Summary) -> list[str]:
    return [
        f"{case_title(case)}: {_lost_at_once(case)}in theory {_stability(theory)}"
        f"{_windows(theory.get('unstable_ms'))}."
        for case in summary["cases"]
        if (theory := case.get("theory")) and "reason" not in theory
    ]


def _lost_at_once(case: Summary) -> str:
    """Return the reason why a case is lost at its first value, to go before theory's."""
    return f"{loss_text(case)}; " if case.get("completed") and case["margin"] is None else ""


def _without_theory(summary: Summary) -> list[Summary]:
    return [case for case in summary["cases"] if "constant_ms" not in (case.get("theory") or {})]


def _too_slow(summary: Summary) -> list[str]:
    """Return a sentence on growth that runs are too short to show, where theory knows none."""
    probes = (probe_at(case, case["margin"]) or {} for case in _without_theory(summary))
    most_hz = max((probe.get("not_tested_below_hz") or 0.0 for probe in probes), default=0.0)
    if not most_hz:
        return []
    return [
        f"Not tested below {most_hz:.2g} Hz: runs at the margins are too short to show whether so"
        " slow an oscillation grows inside its bounds."
    ]


def _gaps(summary: Summary) -> list[str]:
    """Name the widest gap between tried values, where theory knows no window of instability."""
    gaps = [case.get("widest_gap", 0.0) for case in _without_theory(summary)]
    if max(gaps, default=0.0) <= summary["resolution"]:
        return []
    width = value_text(max(gaps), summary)
    return [
        f"Up to the margins, values at most {width} apart were tried: a narrower window in which a"
        " loop is unstable may lie between them."
    ]


def _stability(theory: Summary) -> str:
    if (growth := theory.get("unstable_without_delay")) is not None:  # older ones lack it
        hertz = growth["frequency_hz"]
        swings = f"at {hertz:g} Hz" if hertz else "without swinging"
        return (
            f"unstable without a delay: it grows by {growth['rate_per_s']:g}/s {swings}"
            f" ({_OF_THEORY}; {growth['joint']} moves most)"
        )
    weakest = f"; weakest: {theory['joint']}" if theory["joint"] else ""
    return (
        f"stable up to a constant {theory['constant_ms']:g} ms, and below"
        f" {theory['any_pattern_ms']:g} ms for every pattern (round trip; {_OF_THEORY}{weakest})"
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


def furthest(summary: Summary) -> str:
    """Return the superlative of a margin: largest, or smallest where values shrink."""
    return "smallest" if any(case["growth"] < 0 for case in summary["cases"]) else "largest"


def kept_text(case: Summary, summary: Summary) -> str:
    """Up to where enough plants are kept, with the interval of their share there."""
    at = _kept_last(case)
    if at is None:
        return "not known yet" if case["values"][0].get("tolerated", False) is None else "none"
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
