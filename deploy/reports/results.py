"""What a command leaves of a run, of runs side by side or of a study: summary and report.

What only some commands need is imported by them alone: every command imports this.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

from bus_schema.recording.atomic_files import write_json
from deploy.judge.conditions import Conditions, conditions_of_recording, conditions_of_runs
from deploy.judge.metrics import summarise
from deploy.judge.run_data import RunData
from deploy.judge.run_rows import read_rows, write_rows
from deploy.judge.verdict import Verdict, decide, with_verdict
from deploy.run.confirmation import CONFIRMATION, CONFIRMATION_COLUMNS
from deploy.run.fault_record import write_fault_record
from deploy.run.run_folder import ResultFolder, RunFolder, read_manifest, read_summary
from deploy.run.stop_signals import end_if_asked

if TYPE_CHECKING:
    from deploy.study.comparison.comparison import ComparedRuns
    from deploy.study.comparison.recorded import RecordedRuns
    from deploy.study.folder import StudyFolder
    from deploy.study.study import StudyOfRuns


def write_run_results(
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
        write_fault_record(run, folder.fault)
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


def write_diff_results(
    compared: RecordedRuns, folder: ResultFolder, *, draws_report: bool = True
) -> None:
    """Write the summary of recorded runs side by side, and their report."""
    from deploy.study.comparison.recorded import KIND

    conditions = _conditions_of_all(compared)
    if draws_report:
        from deploy.reports.run_reports import write_diff_report  # with all figures

        write_diff_report(compared, folder.report, conditions)
    summary = {
        "kind": KIND,
        "name": " ".join(compared.labels),
        "completed": True,
        "runs": {run.law: run.summary for run in compared.runs},
        "paths": [str(path.resolve()) for path in compared.paths],
        "partings": [parting and parting._asdict() for parting in compared.partings],
        "differing": compared.differing,
        "conditions": conditions,
    }
    write_json(folder.summary, summary)


def write_study_results(study: StudyOfRuns, folder: StudyFolder) -> dict[str, Any]:
    """Judge the rows of a study and write table, summary and report; the summary."""
    from deploy.reports.study_report import write_study_report  # with all figures

    summary = judge_rows(study, folder)
    write_json(folder.summary, {**summary, "completed": False})  # until all is written
    write_study_report(summary, folder)
    write_json(folder.summary, summary)
    return summary


def judge_rows(study: StudyOfRuns, folder: StudyFolder) -> dict[str, Any]:
    """What the rows of a study say, once its table is written."""
    summary = study.summary(folder.rows)
    study.keep_files(summary, folder.path)
    summary["conditions"] = study.conditions(summary, read_manifest(folder.path))
    folder.write(summary["conditions"], completed=summary["completed"])
    return summary


def write_comparison_results(folder: ResultFolder, summary: Mapping[str, Any]) -> ComparedRuns:
    """Judge the recordings of a comparison and write table, summary and report; its runs.

    Args:
        folder: where they are.
        summary: what its rows, or its folder, say of it.

    Raises:
        RunFolderError: a recording is missing or cannot be read.
    """
    from deploy.reports.run_reports import write_comparison_report  # with all figures
    from deploy.study.comparison.comparison import COLUMNS, KIND, compared_in, rows_again

    compared, file = compared_in(folder.path, summary), folder.path / f"{KIND}.parquet"
    setups = [run.data.setup for run in compared.runs]
    of_runs: dict[str, Any] = {"laws": {run.law: run.summary for run in compared.runs}}
    if setups:
        of_runs["clock"] = compared.runs[0].summary["clock"]
        of_runs["conditions"] = conditions_of_runs(setups, read_manifest(folder.path))
        before = read_rows(file) if file.is_file() else []
        confirmed = CONFIRMATION_COLUMNS if any("confirmed_on" in each for each in before) else {}
        rows, columns = rows_again(compared, before), {**COLUMNS, **confirmed}
        write_rows(rows, file, columns, of_runs["conditions"])
        write_comparison_report(compared, folder.report, of_runs["conditions"])
    write_json(folder.summary, {**summary, **of_runs})
    return compared


def load_report() -> Callable[..., None]:
    """What writes the report of a run; figures take their time to import."""
    from deploy.reports.run_reports import write_report

    return write_report


def conditions_in(folder: RunFolder, run: RunData) -> Conditions:
    """Under what conditions a run came about, as its folder has them."""
    return conditions_of_recording(run, read_manifest(folder.path))


def _conditions_of_all(compared: RecordedRuns) -> Conditions:
    """Under what conditions the runs came about: once where it is the same for all."""
    by_run = [
        conditions_of_recording(run.data, manifest)
        for run, manifest in zip(compared.runs, compared.manifests, strict=True)
    ]
    merged = {}
    for name in by_run[0]:
        found = [each[name] for each in by_run]
        by_label = (f"{label}: {text}" for label, text in zip(compared.labels, found, strict=True))
        merged[name] = found[0] if len(set(found)) == 1 else "; ".join(by_label)
    return merged
