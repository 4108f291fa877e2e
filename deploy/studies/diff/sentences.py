"""The verdict on recorded runs side by side, in words."""

from __future__ import annotations

from typing import TYPE_CHECKING

from deploy.judge.recorded_ticks import known_ticks
from deploy.reports.page import ReportHead
from deploy.reports.tables import number
from deploy.reports.verdict_texts import head_of_runs, recording_sentences

if TYPE_CHECKING:
    from deploy.study.comparison.recorded import Parting, RecordedRuns


def verdict_on_runs(compared: RecordedRuns) -> ReportHead:
    """Return the head of a report on recorded runs: whether they are equal, and where they part."""
    runs, keys = compared.runs, len(compared.differing)
    has_gaps = any(known_ticks(run.data).missing for run in runs)
    every = "every tick that is known of both" if has_gaps else "every tick"
    reasons = [
        f"{label}: {_parting_text(parting, compared.labels[0], every)}"
        for label, parting in zip(compared.labels[1:], compared.partings[1:], strict=True)
    ]
    reasons += [f"{label}: {text}" for label, text in compared.differences_of_arithmetic.items()]
    reasons += recording_sentences(runs)
    differ = "value differs" if keys == 1 else "values differ"
    reasons.append(f"{keys or 'No'} {differ} between the scenarios.")
    kept = sum(run.kept_bounds for run in runs)
    headline = f"{kept} of {len(runs)} runs kept their bounds; they are {_same(compared, every)}"
    return head_of_runs(runs, headline, reasons)


def _same(compared: RecordedRuns, every: str) -> str:
    partings = [parting for parting in compared.partings if parting is not None]
    if not partings:
        return f"the same at {every}"
    has_same_begin = all(each.is_end and each.largest_rad is not None for each in partings)
    return "the same until one ends" if has_same_begin else "not the same"


def _parting_text(parting: Parting | None, first: str, every: str) -> str:
    if parting is None:
        return f"bit-identical to {first} at {every}"
    if parting.largest_rad is None:
        return f"has no tick at the time of one of {first}"
    if parting.is_end:
        return (
            f"bit-identical to {first} at {every} before {parting.tick}, where one of the runs ends"
        )
    apart = number(parting.largest_rad, 1e3, " mrad")
    return (
        f"differs from {first} from tick {parting.tick} on ({number(parting.time_s)} s); positions"
        f" differ by at most {apart}"
    )
