"""The end of a run: it is judged, and its summary and report are written."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from bus_schema.recording.atomic_files import write_json
from deploy.runs.conditions import Conditions, conditions_of_recording
from deploy.runs.confirmation import CONFIRMATION
from deploy.runs.fault_record import fault_record
from deploy.runs.judging.metrics import summarise
from deploy.runs.judging.verdict import Verdict, decide, with_verdict
from deploy.runs.run_data import RunData
from deploy.runs.run_folder import RunFolder, read_manifest, read_summary
from deploy.stop_signals import end_if_asked


def conclude(
    folder: RunFolder,
    run: RunData,
    *,
    draws_report: bool = True,
    confirmation: Sequence[Mapping[str, Any]] = (),
) -> dict[str, Any]:
    """Judge a run and write summary, report and the record of its fault; the summary.

    Args:
        folder: where.
        run: its data.
        draws_report: a report takes longer than all else.
        confirmation: what other physics say of it; where there is nothing, what the folder has.
    """
    confirmed = confirmation or read_summary(folder.path).get(CONFIRMATION)
    summary = summarise(run) | ({CONFIRMATION: confirmed} if confirmed else {})
    write_json(folder.summary, with_verdict(summary, Verdict.INTERRUPTED))  # until all is written
    try:
        if (record := fault_record(run)) is not None:
            write_json(folder.fault, record)
        end_if_asked()
        if draws_report:
            write_report = load_report()
            end_if_asked()
            write_report(run, summary, folder.report, conditions_in(folder, run))
    except OSError as error:
        summary["faults"].append(f"{error.filename}: cannot be written: {error.strerror}")
        summary = with_verdict(summary, decide(summary["faults"]))
    with contextlib.suppress(OSError):  # a full disk has the one from before
        write_json(folder.summary, summary)
    return summary


def load_report() -> Callable[..., None]:
    """What writes a report; figures take their time to import."""
    from deploy.reports.run_report import write_report

    return write_report


def conditions_in(folder: RunFolder, run: RunData) -> Conditions:
    """Under what conditions a run came about, as its folder has them."""
    return conditions_of_recording(run, read_manifest(folder.path))
