"""Results of recorded runs side by side."""

from __future__ import annotations

from pathlib import Path

from deploy.judge.conditions import conditions_of_recording
from deploy.reports.results import Again, Results, write_results
from deploy.run.run_folder import ResultFolder
from deploy.studies.diff.page import diff_page
from deploy.study.comparison.recorded import KIND, RecordedRuns, read_again


def diff_results(compared: RecordedRuns) -> Results:
    """Judge recorded runs side by side."""
    conditions = _conditions_of_all(compared)
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
    return Results(summary, diff_page(compared, conditions), compared.runs)


def _conditions_of_all(compared: RecordedRuns) -> dict[str, str]:
    """Return the conditions of the runs: each once if it is the same for all."""
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


def diff_again(path: Path) -> Again:
    """Judge recorded runs side by side."""
    results, folder = diff_results(read_again(path)), ResultFolder(path.resolve())
    return folder, lambda: write_results(folder, results)
