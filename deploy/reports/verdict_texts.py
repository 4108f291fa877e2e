"""The verdict on one run or several, put into words; `deploy.judge.verdict` is what decides."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

from deploy.judge.bounds import plant_count
from deploy.judge.findings.loss_reason import LossReason, Reason
from deploy.judge.metrics import RunResult
from deploy.judge.motion.chunks import Chunks
from deploy.judge.recorded_ticks import KnownTicks, known_ticks
from deploy.judge.run_data import RunData
from deploy.judge.verdict import Verdict
from deploy.reports.page import ReportHead, level_of
from deploy.reports.runs.host_sentences import sentences_on_the_host
from deploy.reports.runs.robot_sentences import helps, sentences_on_the_robot
from deploy.reports.runs.run_numbers import margin_place, other_margins
from deploy.reports.tables import margin_text, number

if TYPE_CHECKING:
    from deploy.run.execute import JudgedRun


PARTIAL = "The recording is incomplete: the recorder did not finish it."
UNCHECKED = (
    "The recording has no checksum over all its bytes: damage between messages would not"
    " be detected."
)
_NO_COMMAND = "no command ever acted on the arm"
_MRAD = 1e3
_SHOWN_FAULTS = 2
_NAMED_JOINTS = 2


def verdict_on_run(
    judged: JudgedRun, manifest: Mapping[str, Any] = MappingProxyType({})
) -> ReportHead:
    """Return the verdict on a run.

    Args:
        judged: the run.
        manifest: ``manifest.json`` of its folder; empty where there is none.
    """
    run, result = judged.data, judged.result
    bounds, known = result.bounds, known_ticks(run)
    is_judged = bounds.violation_fraction is not None
    reasons = [
        f"The true error was {_bounds_text(result, known)}."
        if is_judged
        else "No tick was recorded, so there is no verdict on the bounds.",
        *remedy_sentences(judged),
        *sentences_on_the_host(judged, manifest),
        *other_margins(bounds, run.setup.scenario.metrics.from_s),
        *_sentences_on_the_tip(result, run.setup.scenario.metrics.from_s),
        *sentences_on_the_robot(run, result),
        *(
            f"The error of {each.joint} grows by e^({each.rate_per_s:.3g} t) at"
            f" {each.frequency_hz:.3g} Hz over the last half of the run: this loop is unstable."
            for each in result.growing
        ),
        *(
            f"The torque of {each.joint} swings between its limits at"
            f" {each.frequency_hz:.3g} Hz ({100 * each.saturated_fraction:.2g} % of the ticks"
            f" saturated, RMS {100 * each.torque_rms_share:.2g} % of the limit, last half of the"
            " run): this loop vibrates."
            for each in result.vibrating
        ),
        *_sentences_on_chunks(result.chunks),
        *_sentences_on_ranges(result),
        *_shortcomings(run, result, known),
    ]
    level, headline = judged.verdict.level, judged.verdict.headline
    if is_judged and judged.verdict is Verdict.NOTHING:
        headline = _NO_COMMAND.capitalize()
    if result.recording.damage:
        headline = f"Recording damaged: {headline[0].lower()}{headline[1:]}"
    if level == "broken" and bounds.violation_fraction:
        headline += ", bounds not kept"
    elif level == "broken" and is_judged:
        headline += ", inside its bounds at all known ticks"
    return ReportHead(level, headline, reasons, result.faults)


def _sentences_on_the_tip(result: RunResult, from_s: float) -> list[str]:
    """Return how far the tip was off: as the arm left its bounds, and from a time on."""
    tip, parts = result.tip_error_mm, []
    if result.loss is not None and tip.at_loss is not None:
        at = f"as the arm left its bounds at {result.loss.time_s:.3f} s"
        parts.append(f"by {number(tip.at_loss)} mm {at}")
    if tip.rms is not None and tip.largest is not None:
        most = f"{number(tip.largest)} mm at most"
        parts.append(f"by {number(tip.rms)} mm RMS, {most}, from {from_s:g} s on")
    return [f"The tip was off {', and '.join(parts)}."] if parts else []


def _sentences_on_chunks(chunks: Chunks | None) -> list[str]:
    """Return what is worth a look of a slow law's answers: jumps, jerk, ages, and waiting."""
    if chunks is None or not chunks.switches or not chunks.age_ms:
        return []
    ages, bound_ms, share = chunks.age_ms, chunks.age_bound_ms, chunks.starved_share
    bound = "" if bound_ms is None else f"; d + s is {number(bound_ms)} ms"
    waited = (
        f" The arm waited, with nothing left to send, at {100.0 * share:.3g} % of the states"
        f" ({chunks.starved_ticks:,})."
        if share
        else ""
    )
    return [
        f"{chunks.switches} new answers of the law{_jump_text(chunks)}.{_jerk_text(chunks)} The"
        f" observation behind an answer in force was {number(ages['median'])} ms old (median),"
        f" {number(ages['largest'])} ms at most{bound}.{waited}"
    ]


def _jump_text(chunks: Chunks) -> str:
    if chunks.jump_rad is None:
        return ""
    return (
        f", largest jump of a target {number(_MRAD * chunks.jump_rad)} mrad ({chunks.jump_joint} at"
        f" {chunks.jump_s:.2f} s), of the tip {number(chunks.jump_mm)} mm"
    )


def _jerk_text(chunks: Chunks) -> str:
    if chunks.jerk_rad_s3 is None:
        return ""
    return (
        f" Jerk of the commanded motion: {number(chunks.jerk_rad_s3)} rad/s³ at most"
        f" ({chunks.jerk_joint}), RMS {number(chunks.jerk_rms_rad_s3)} rad/s³."
    )


def _sentences_on_ranges(result: RunResult) -> list[str]:
    """Return a sentence about joints that pass their ranges by much."""
    if not (found := result.beyond_ranges):
        return []
    named = ", ".join(
        f"{each.joint} by {number(each.beyond_rad)} rad at {each.time_s:.2f} s"
        for each in found[:_NAMED_JOINTS]
    )
    more = f" and {len(found) - _NAMED_JOINTS} more" * (len(found) > _NAMED_JOINTS)
    what = "a real arm hits its stops there, which are not emulated"
    return [f"Warning: joints passed the ends of their ranges: {named}{more}; {what}."]


def damaged(damage: Sequence[str]) -> str:
    """Describe a damaged recording."""
    return f"The recording is damaged: {'; '.join(damage)}."


def _shortcomings(run: RunData, result: RunResult, known: KnownTicks) -> list[str]:
    """Everything but faults that makes this less than a whole run on an undisturbed machine."""
    found = []
    if result.recording.damage:
        found.append(damaged(result.recording.damage))
    elif not run.complete:
        found.append(PARTIAL)
    if (found or known.missing) and (counted := plant_count(run).get("outside")):
        found.append(f"The plant itself counted {counted:,} ticks outside its bounds.")
    if known.missing:
        found += [missing_ticks_sentence(known), *_sentences_on_gaps(result)]
    if run.lacks_checksums:
        found.append(UNCHECKED)
    found.extend(f"{note}." for note in run.notes)
    planned_s = run.setup.scenario.duration_s
    if not result.completed and result.duration_s < planned_s:
        found.append(f"The data end at {result.duration_s:.3f} s of {planned_s:g} s planned.")
    if run.lost:
        missed = ", ".join(f"{topic} {count:,}" for topic, count in run.lost.items())
        found.append(f"{sum(run.lost.values()):,} messages are missing in the recording: {missed}.")
    return found


def _sentences_on_gaps(result: RunResult) -> list[str]:
    """Explain the effect of missing ticks on numbers that rest on neighbouring ones."""
    recording = result.recording
    left_out_s = recording.torque_left_out_s
    pairs = zip(result.tracking.joint_names, recording.settling_is_latest, strict=True)
    names = ", ".join(name for name, is_latest in pairs if is_latest)
    latest = f"Settled at the given time or earlier, because ticks are missing: {names}."
    torques = f"Variation and spectrum of the torques leave out {left_out_s:.3f} s around the gaps."
    return [*([latest] if names else []), *([torques] if left_out_s else [])]


def missing_ticks_sentence(known: KnownTicks) -> str:
    """Describe the ticks that are not in a recording."""
    return (
        f"The true motion is known at {known.known:,} of {known.ticks:,} ticks; those at"
        f" {known.gaps_text} are missing."
    )


def _bounds_text(result: RunResult, known: KnownTicks) -> str:
    """Describe the error within its bounds, at the ticks that are known."""
    bounds, damage = result.bounds, result.recording.damage
    is_all = not known.missing and not damage
    of_all = f" of {known.ticks:,}" if known.missing else ""
    where = f"the {known.known:,}{of_all} ticks at which it is known"
    margin, place = bounds.margin_min, margin_place(bounds)
    if not bounds.violation_fraction:
        ticks = f"all {known.ticks:,} ticks" if is_all else where
        left = f"with at least {margin_text(margin)} of the bound left{place}"
        return f"inside its bounds at {ticks}, {left}"
    times = "an unknown multiple of" if margin is None else f"{number(1.0 - margin)} times"
    return (
        f"outside its bounds at {number(bounds.violation_fraction, 100)} % of"
        f" {'the ticks' if is_all else where}, for the first time at"
        f" {bounds.first_violation_s:.3f} s{_loss_text(result.loss)}, and at most"
        f" {times} its bound{place}"
    )


def loss_words(loss: LossReason) -> str:
    """Return how a joint's error left its funnel, in words."""
    words, hertz, lag_ms = loss.reason.words, loss.frequency_hz, loss.lag_ms
    if loss.fault is not None:
        return f"{words} {loss.fault}"
    if (own_ms := loss.own_lag_ms) is not None:
        return f"{words} of {own_ms:.0f} ms"
    if loss.delay_ms is not None:
        return f"{words} of {loss.delay_ms:.0f} ms"
    words = f"{lag_ms:.0f} ms {words}" if lag_ms is not None else words
    words += "" if hertz is None else f" at {hertz:.2g} Hz"
    if loss.reason is Reason.UNSTABLE and (rate := loss.rate_per_s) is not None:
        words += f" by e^({rate:.3g} t)"
    if loss.reason in (Reason.UNSTABLE, Reason.GROWING, Reason.SWINGING) and loss.without_delay:
        words += ", even without a delay"
    return words


def remedy_sentences(run: JudgedRun) -> list[str]:
    """Return what helps a lost run, where that is known."""
    loss = run.result.loss
    return [] if loss is None else helps(loss.reason, run.data)


def _loss_text(loss: LossReason | None) -> str:
    """Return the reason why a run left its funnel, as a part of a sentence."""
    return "" if loss is None else f" ({loss.joint}, {loss_words(loss)})"


def head_of_runs(runs: Sequence[JudgedRun], headline: str, reasons: Sequence[str]) -> ReportHead:
    """Return how each run ended, and the level: how many of them kept their bounds."""
    sentences = [*(f"{run.law}: {bounds_sentence(run)}" for run in runs), *reasons]
    unsound = [run for run in runs if not is_sound(run)]
    if unsound:
        unread = (
            " or cannot be read completely" if Verdict.UNKNOWN in {r.verdict for r in runs} else ""
        )
        return ReportHead("broken", f"{headline}, {len(unsound)} did not finish{unread}", sentences)
    kept = sum(run.kept_bounds for run in runs)
    return ReportHead(level_of(kept, len(runs)), headline, sentences)


def is_sound(run: JudgedRun) -> bool:
    """Whether it came to its end, and is known whole."""
    return run.verdict in (Verdict.KEPT, Verdict.LOST)


def bounds_sentence(run: JudgedRun) -> str:
    """Say whether a law kept its bounds, or how it failed."""
    faults, known = run.result.faults, known_ticks(run.data)
    if faults:
        return "; ".join(faults[:_SHOWN_FAULTS])
    if run.verdict is Verdict.INTERRUPTED:
        return "did not finish"
    if run.verdict is Verdict.NOTHING:
        is_judged = run.result.bounds.violation_fraction is not None
        return _NO_COMMAND if is_judged else "has no tick"
    if run.verdict is Verdict.LOST and not run.result.bounds.violation_fraction:
        return (
            "left its bounds at ticks that are missing in the recording, by the plant's own count"
        )
    return _bounds_text(run.result, known)


def recording_sentences(runs: Iterable[JudgedRun]) -> list[str]:
    """Describe what the recordings of runs lack, each with its law."""
    found = []
    for run in runs:
        if damage := run.result.recording.damage:
            found.append(f"{run.law}: {damaged(damage)}")
        if (known := known_ticks(run.data)).missing:
            found.append(f"{run.law}: {missing_ticks_sentence(known)}")
    return found
