"""The report of recorded runs side by side: their figures, overlaid."""

from __future__ import annotations

from functools import partial
from pathlib import Path

from bus_schema.recording.atomic_files import write_json
from deploy.comparison.comparison import Comparison
from deploy.comparison.recorded import KIND, RecordedRuns
from deploy.reports import quantities
from deploy.reports.figures.arm.end_effector import tip_paths
from deploy.reports.figures.errors import error_envelopes, errors_first_second, errors_in_funnel
from deploy.reports.figures.laws import joint_bars
from deploy.reports.figures.studies.recorded import positions_apart, time_percentiles
from deploy.reports.figures.torque import torque_spectra, torques_by_law
from deploy.reports.page import Fact, Panel, write_page
from deploy.reports.studies.diff_tables import (
    joint_tables,
    run_tables,
    timing_table,
    verdict_on_runs,
)
from deploy.runs.conditions import Conditions, conditions_of_recording
from deploy.runs.run_folder import ResultFolder

PANELS: list[Panel[Comparison]] = [
    Panel(
        "Joint errors", "errors", "True errors inside their bounds", errors_in_funnel,
        "The shaded band is the funnel of the first run. The scale is that of its steady state. A"
        " click in the legend hides a run.",
    ),
    Panel(
        "Joint errors", "errors-first-second", "The first second", errors_first_second,
        "Runs that lie on each other here and part later differ in what happened, not in how they"
        " began.",
    ),
    Panel(
        "Joint errors", "error-envelopes", "Size of the errors", error_envelopes,
        "The largest |e| in each twentieth of a second, on a logarithmic scale. Dotted: the first"
        " run's bounds in their steady state.",
    ),
    Panel(
        "Joint errors", "rms", "RMS error of every joint",
        partial(joint_bars, quantity=quantities.RMS_ERROR),
        "On a logarithmic scale.",
    ),
    Panel(
        "Motion", "positions-apart", "How far positions are from those of the first run",
        positions_apart,
        "At the same instant, on a logarithmic scale. Where a line is missing, the runs have the"
        " same bits.",
    ),
    Panel(
        "Motion", "tip-paths", "Path of the end effector", tip_paths,
        "Grey: the reference of the first run. Drag to turn, scroll to zoom.",
    ),
    Panel(
        "Torque", "torques", "Commanded torques", torques_by_law,
        "One column per run, one scale along each row.",
    ),
    Panel(
        "Torque", "torque-spectra", "Torque by frequency", torque_spectra,
        "Amplitude in each hertz. To the right of the dotted line it counts as chatter.",
    ),
    *(
        Panel(
            "Timing", key.removesuffix("_us").replace("_", "-"), title,
            partial(time_percentiles, key=key),
            "By percentile. A line that climbs at the right has rare, long delays; zeros have no"
            " place on this scale and are not drawn.",
        )
        for key, title in quantities.TIMES.items()
    ),
]  # fmt: skip
"""The figures of the report, in order; another one is another entry."""


def conclude_diff(
    compared: RecordedRuns, folder: ResultFolder, *, draws_report: bool = True
) -> None:
    """Write the summary of recorded runs side by side, and their report."""
    conditions = conditions_of(compared)
    if draws_report:
        _write_report(compared, folder.report, conditions)
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


def _write_report(compared: RecordedRuns, path: Path, conditions: Conditions) -> None:
    verdict = verdict_on_runs(compared)
    places = zip(compared.labels, compared.paths, strict=True)
    write_page(
        path,
        "diff.html",
        PANELS,
        compared.comparison,
        title=f"{' · '.join(compared.labels)} · {verdict.headline}",
        verdict=verdict,
        facts=[Fact(label, str(place)) for label, place in places],
        conditions=conditions,
        run_tables=run_tables(compared),
        joint_tables=joint_tables(compared),
        timing_tables=[timing_table(compared)],
    )


def conditions_of(compared: RecordedRuns) -> Conditions:
    """Under what conditions the runs came about: once where it is the same for all."""
    by_run = [
        conditions_of_recording(run.data, manifest)
        for run, manifest in zip(compared.runs, compared.manifests, strict=True)
    ]
    merged = {}
    for name in by_run[0]:
        told = [each[name] for each in by_run]
        by_label = (f"{label}: {text}" for label, text in zip(compared.labels, told, strict=True))
        merged[name] = told[0] if len(set(told)) == 1 else "; ".join(by_label)
    return merged
