"""The end of a study: it is judged, and its table, summary and report are written."""

from __future__ import annotations

from typing import Any

from bus_schema.recording.atomic_files import write_json
from deploy.runs.run_folder import read_manifest
from deploy.study.conditions import conditions_of_study
from deploy.study.folder import StudyFolder
from deploy.study.study import Study


def conclude_study(study: Study, folder: StudyFolder) -> dict[str, Any]:
    """Judge the rows of a study and write table, summary and report; the summary."""
    # Figures take their time to import.
    from deploy.reports.studies.study_report import write_study_report

    summary = study.summary(folder.rows)
    summary["conditions"] = conditions_of_study(study, summary, read_manifest(folder.path))
    folder.put_together(summary["conditions"], completed=summary["completed"])
    write_json(folder.summary, {**summary, "completed": False})  # until all is written
    write_study_report(summary, folder)
    write_json(folder.summary, summary)
    return summary
