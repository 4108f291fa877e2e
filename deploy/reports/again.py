"""Evaluate recorded results again: the folder of each kind of result, and what judges it."""

from __future__ import annotations

from pathlib import Path

from bus_schema.foreign_text import say
from deploy.reports.kinds import kind_of, study_type
from deploy.reports.results import Again, Results, write_results, write_run
from deploy.reports.studies.results import study_results, write_study
from deploy.run.execute import JudgedRun
from deploy.run.run_folder import RunFolder, RunFolderError, load_run, read_summary
from deploy.scenario.yaml_files import ScenarioError, naming, read_yaml
from deploy.study.execution.folder import StudyFolder
from deploy.study.execution.identity import STUDY_FILE, changes_since
from deploy.study.execution.runner import retrace
from deploy.study.study import StudyOfRuns


def evaluated_again(path: Path) -> Again:
    """Return the folder of recorded results, and what judges them again.

    Args:
        path: the folder, or the MCAP file of a run.

    Raises:
        RunFolderError: it holds no results.
        ScenarioError: its study cannot be used.
    """
    again = kind_of(read_summary(path)).again
    if again is None:
        again = _study_again if (path / STUDY_FILE).is_file() else _run_again
    return again(path)


def read_study(path: Path) -> StudyOfRuns:
    """Return the study in a folder.

    Raises:
        RunFolderError: it holds no study.
        ScenarioError: the study cannot be used.
    """
    file = path / STUDY_FILE
    values = read_yaml(file)
    if not isinstance(values.get("definition"), dict):
        raise RunFolderError(f"{file}: must have the kind of a study, and definition")
    with naming(file):
        study = study_type(str(values.get("kind")))
    return study(values["definition"], file)


def _run_again(path: Path) -> Again:
    run = JudgedRun(path.name, load_run(path)[0], path=path)
    folder = RunFolder(path if path.is_dir() else path.parent)
    return folder, lambda: write_run(folder, run)


def _study_again(path: Path) -> Again:
    """Judge the rows of a study; show its earlier summary if they cannot be judged alike today.

    So it is if its scenarios or laws have changed, or if its search needs other runs today.
    """
    study = read_study(path)
    folder = StudyFolder(path.resolve(), study)

    def judge() -> Results:
        changed = "; ".join([*changes_since(study, folder.path), *folder.law_changes])
        summary = read_summary(folder.path)
        if not changed:
            study.recall(summary)
            retrace(study, folder)
            if not summary.get("completed") or study.findings(folder.rows)["completed"]:
                return write_study(study, folder)
            changed = "made by another search"
        if "conditions" not in summary:
            raise ScenarioError(
                f"{folder.path}: {changed}: must be as it was, as no summary is there"
            )
        say(f"{changed}: this is the summary of before")
        return write_results(folder, study_results(summary, folder))

    return folder, judge
