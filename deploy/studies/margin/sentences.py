"""Margins in sentences."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from deploy.reports.studies.case_result import case_title, equipment_text
from deploy.reports.studies.case_sentences import doubts, saved_runs
from deploy.reports.studies.study_texts import (
    listed,
    losses_text,
    reason_sentences,
    remedy_text,
    value_text,
)
from deploy.scenario.playout import EXPECTED
from deploy.studies.margin.result import MarginCase, MarginResult
from deploy.studies.margin.texts import (
    because_text,
    furthest,
    furthest_case,
    least_case,
    margin_text,
    number_text,
    pattern_text,
    quoted_text,
    rotors_text,
)
from deploy.studies.margin.theory_sentences import in_theory, theory_sentences
from deploy.study.study import rows_by


def _pattern_sentence(case: MarginCase, summary: MarginResult) -> str | None:
    """Describe a case under delays that vary."""
    if case.guaranteed:
        playout, remedy = _playout_texts(case)
        return (
            f"{case_title(case)}: holds for every delay up to"
            f" {value_text(case.guaranteed, summary)} that arrives in order and is not lost,"
            f" with {playout}; the motion is the same to the bit in"
            f" {case.patterns.tried} patterns.{remedy}"
        )
    if (worst := case.worst_pattern) is None:
        return None
    name = ", ".join(f"{key} {value}" for key, value in worst.pattern.items())
    return (
        f"{case_title(case)}: every pattern of delays: {pattern_text(case, summary)}. The worst, at"
        f" {value_text(worst.value, summary)}: {name}."
    )


def _playout_texts(case: MarginCase) -> tuple[str, str]:
    """For which play-out time d a guarantee holds; how to set it where the scenario does not."""
    if (d_ms := case.guaranteed_d_ms) is None:  # of an older version
        return "the play-out of the constant delay", ""
    playout = f"a play-out of d = {d_ms:.9g} ms"
    if case.guaranteed_command is None:
        return playout, ""
    own = f" The scenario's own link gives d = {case.scenario_d_ms:.9g} ms at the start"
    return playout, f"{own}: add --set {EXPECTED}={d_ms:.9g}."


def margin_headline(summary: MarginResult) -> str:
    """The margins to quote in one sentence: of the best law on each arm, by its equipment.

    A law has the smaller one of its loops, as a robot that runs has also started. Of more than two
    sets of equipment the best is named.
    """
    cases = summary.cases
    laws, arms = (
        list(dict.fromkeys(getattr(each, key) for each in cases)) for key in ("law", "arm")
    )
    shown = {arm: _decisive(each for each in cases if each.arm == arm) for arm in arms}
    best = {case.law for own in shown.values() for case in own if case.best_known is not None}

    def text(case: MarginCase) -> str:
        return number_text(case, summary) + (f" by {case.law}" if len(best) > 1 else "")

    texts = [
        f"{f'{arm} ' * (len(arms) > 1)}{', '.join(map(text, own))}" for arm, own in shown.items()
    ]
    named = f"{next(iter(best))}, " if len(best) == 1 else ""
    who = f"{named}the best of {len(laws)} laws" if len(laws) > 1 else cases[0].law
    on = "" if len(arms) > 1 else f"{',' * (len(laws) > 1)} on {cases[0].arm}"
    kept = f"{furthest(summary).capitalize()} {summary.title} kept by {who}{on}{model_text(cases)}"
    return f"{kept}: {'; '.join(texts)}"


def _decisive(cases: Iterable[MarginCase]) -> list[MarginCase]:
    """Return the cases of an arm whose numbers are quoted: the worse loop of the best law."""
    laws = rows_by(cases, lambda case: (equipment_text(case), case.law))
    equipment = rows_by(map(least_case, laws.values()), equipment_text)
    best = list(map(furthest_case, equipment.values()))
    return best if len(best) <= 2 else [furthest_case(best)]


def model_text(cases: Sequence[MarginCase]) -> str:
    """Describe how the model that compensation predicts with differs from the arm."""
    compensated = (case for case in cases if case.compensation)
    scales = {case.model_scale for case in compensated if case.model_scale is not None}
    if scales <= {1.0}:
        return ", with an exact model" * bool(scales)
    return f", with a model of {' or '.join(f'{each:g}' for each in sorted(scales))} × its masses"


def margin_sentences(summary: MarginResult) -> list[str]:
    """Return margins in words, the best first."""
    patterns = filter(None, (_pattern_sentence(case, summary) for case in summary.cases))
    found = [
        *_headlines(summary),
        *lost_at_once(summary),
        *none_quoted(summary),
        *patterns,
        *_held_again(summary),
        *_flawed(summary),
        *_reasons(summary),
    ]
    rotors = [
        f"{case_title(case)}: {margin_text(case, summary)} with the estimated rotors,"
        f" {smaller} with a tenth of them."
        for case in summary.cases
        if (smaller := rotors_text(case, summary))
    ]
    limits = [*_gaps(summary), *_too_slow(summary)]
    return [*found, *rotors, *theory_sentences(summary), *limits, *saved_runs(summary)]


def brief_margin_sentences(summary: MarginResult) -> list[str]:
    """Return margins in words, without what a table beside them says."""
    patterns = filter(None, (_pattern_sentence(case, summary) for case in summary.cases))
    found = [*doubts(summary.cases), *lost_at_once(summary), *none_quoted(summary), *patterns]
    limits = [*_gaps(summary), *_too_slow(summary)]
    return [*found, *_reasons(summary), *_held_again(summary), *in_theory(summary), *limits]


def _headlines(summary: MarginResult) -> list[str]:
    """Name the best case on each arm: first of loops that run, then of those that start so."""
    arms = dict.fromkeys(case.arm for case in summary.cases)
    return [
        _best(summary, own, arm)
        for arm in arms
        for running in (True, False)
        if (own := [c for c in summary.cases if (c.arm, c.running) == (arm, running)])
    ]


def _best(summary: MarginResult, cases: list[MarginCase], arm: str) -> str:
    """Name the case of an arm that takes the most."""
    known = [case for case in cases if case.best_known is not None]
    where = f"{arm}, a loop that already runs" if cases[0].running else arm
    if not known:
        return f"{where}: no law keeps its bounds at all."
    best = furthest_case(known)
    laws: dict[str, list[str]] = {}
    for case in known:
        if case.best_known == best.best_known:
            laws.setdefault(equipment_text(case), []).append(case.law)
    whose = [f"{listed(names)} {equipment}".rstrip() for equipment, names in laws.items()]
    reason = because_text(best)
    margin = f"{furthest(summary)} margin is {quoted_text(best, summary)}"
    margin += f" ({reason})" if reason else ""
    return f"{where}: the {margin}, of {'; of '.join(whose)}." + "".join(
        f" {text}" for text in doubts(cases)
    )


def lost_at_once(summary: MarginResult) -> list[str]:
    """Name what helps each case that has no margin, where that is known."""
    laws = {case.law for case in summary.cases}
    return [
        f"{case_title(case)} is lost already at {value_text(probe.value, summary)}"
        f" ({losses_text(probe)}): {remedy}."
        for case in summary.cases
        if case.completed and case.margin is None
        if (probe := case.probe_at(case.first_failure))
        if (remedy := remedy_text(probe.losses, case.law, laws))
    ]


def none_quoted(summary: MarginResult) -> list[str]:
    """Explain each case without a margin to quote, although its own runs held."""
    return [
        f"{case_title(case)}: {margin_text(case, summary)} held on the arm as given, but the margin"
        f" is none ({because_text(case)}): it is the smallest result of all tests."
        for case in summary.cases
        if case.completed and case.quoted is None and case.margin is not None and because_text(case)
    ]


def _held_again(summary: MarginResult) -> list[str]:
    """A sentence for each case that kept its bounds once more beyond its first failure."""
    return [
        f"{case_title(case)}: held again at"
        f" {', '.join(f'{value:g}' for value in case.held_again)}, beyond its first failure."
        for case in summary.cases
        if case.held_again
    ]


_FLAWS = {
    "runs_growing": "an error grows exponentially in {} of {} runs: this loop is unstable",
    "runs_vibrating": "a torque swings between its limits in {} of {} runs: this loop vibrates",
}
"""Words for runs that do not hold although they kept their bounds."""


def _flawed(summary: MarginResult) -> list[str]:
    """A sentence for each case whose margin ends where a loop grows or vibrates in its bounds."""
    return [
        f"{case_title(case)}: at {value_text(probe.value, summary)}"
        f" {words.format(getattr(probe, name), probe.runs)}."
        for case in summary.cases
        if (probe := case.probe_at(case.first_failure))
        for name, words in _FLAWS.items()
        if getattr(probe, name)
    ]


def _reasons(summary: MarginResult) -> list[str]:
    """Explain the reasons of losses at the first failures, but of loops that keep their bounds."""
    failed = [probe for case in summary.cases if (probe := case.probe_at(case.first_failure))]
    return reason_sentences(
        name
        for probe in failed
        if not any(getattr(probe, flaw) for flaw in _FLAWS)
        for name in probe.losses
    )


def _without_theory(summary: MarginResult) -> list[MarginCase]:
    return [case for case in summary.cases if case.theory is None or not case.theory.knows_windows]


def _too_slow(summary: MarginResult) -> list[str]:
    """Return a sentence on growth that runs are too short to show, where theory knows none."""
    probes = (case.probe_at(case.margin) for case in _without_theory(summary))
    most_hz = max((probe.not_tested_below_hz or 0.0 for probe in probes if probe), default=0.0)
    if not most_hz:
        return []
    return [
        "Runs at the margins are too short to show an oscillation below"
        f" {most_hz:.2g} Hz that grows inside its bounds: a longer --duration shows slower ones."
    ]


def _gaps(summary: MarginResult) -> list[str]:
    """Name the widest gap between tried values, where theory knows no window of instability."""
    gaps = [case.widest_gap for case in _without_theory(summary)]
    if max(gaps, default=0.0) <= summary.resolution:
        return []
    width = value_text(max(gaps), summary)
    return [
        f"Up to the margins, values at most {width} apart were tried: a narrower window in which a"
        " loop is unstable may lie between them."
    ]
