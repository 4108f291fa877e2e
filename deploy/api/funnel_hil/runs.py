"""Single runs: simulated, compared, and read back."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from bus_schema.recording.atomic_files import write_json
from controller.laws.custom import laws_given
from deploy.reports.results import write_results, write_run
from deploy.reports.studies.results import judge_rows
from deploy.run.execute import InProcess, JudgedRun, execute
from deploy.run.network.links import check_link
from deploy.run.new_folder import new_folder
from deploy.run.run_folder import ResultFolder, RunFolder, provenance
from deploy.scenario.study_keys import laws_beside
from deploy.studies.comparison.comparison import LawComparison
from deploy.studies.comparison.results import comparison_results
from deploy.studies.diff.results import diff_results
from deploy.study.comparison.compared_runs import ComparedRuns, judged_again
from deploy.study.comparison.recorded import KIND, recorded_runs
from funnel_hil.results import Comparison, Diff, Run
from funnel_hil.scenarios import Changes, InputError, Law, Scenario, ScenarioLike
from funnel_hil.studies import study_session


def simulate(
    scenario: ScenarioLike = "paper_arm",
    changes: Changes | None = None,
    *,
    law: Law | None = None,
    out: str | Path | None = None,
    overwrite: bool = False,
) -> Run:
    """Run a scenario in this process and in virtual time.

    Args:
        scenario: the name of a shipped scenario, a file, a dictionary, or a `Scenario`.
        changes: values of the scenario by dotted key, or by section.
        law: what to control it with: a name, a class, or a law; the scenario's own by default.
        out: folder for recording, summary and report; nothing is written without.
        overwrite: replace the results that `out` holds.

    Raises:
        InputError: the scenario cannot be used, or `out` holds results. An error in a
            law is a fault of the run, and no exception.
    """
    given = Scenario(scenario, changes, law)
    check_link(given.setup, one_process=True)
    with given.laws():
        if out is None:
            run = execute(given.setup, InProcess())
            return Run(run)
        with RunFolder.begin(given.setup, Path(out), overwrite=overwrite) as folder:
            run = execute(given.setup, InProcess(), folder)
            write_run(folder, run)
            return Run(run)


def compare(
    scenario: ScenarioLike = "paper_arm",
    changes: Changes | None = None,
    *,
    laws: Sequence[Law] | None = None,
    out: str | Path | None = None,
    overwrite: bool = False,
) -> Comparison:
    """Run a scenario under several laws, one after another, in this process and virtual time.

    Args:
        scenario: as for `simulate`.
        changes: as for `simulate`.
        laws: names, classes or laws; all shipped ones and the scenario's own by default.
        out: folder for recordings, rows, summary and report; nothing is written without.
        overwrite: replace the results that `out` holds.

    Raises:
        InputError: as `simulate`.
    """
    base = Scenario(scenario, changes)
    tried = [Scenario(base, law=law) for law in laws or laws_beside(base.law)]
    if len({each.law for each in tried}) < len(tried):
        raise InputError(
            f"laws: must have different names: {', '.join(each.law for each in tried)}"
        )
    if out is None:
        return Comparison(ComparedRuns([_judged(each) for each in tried]))
    makers = {name: make for each in tried for name, make in each.makers.items()}
    values = {"laws": [each.law for each in tried]}
    with laws_given(makers), study_session(
        [base], lambda files: LawComparison({"scenario": files[0], **values}, Path("compare")),
        Path(out), overwrite=overwrite,
    ) as (study, folder):  # fmt: skip
        results, compared = comparison_results(folder, judge_rows(study, folder))
        write_results(folder, results)
        return Comparison(compared)


def load_run(path: str | Path) -> Run:
    """A recorded run: its folder, or its MCAP file.

    The recording may be anybody's: no law that it names is imported. It is judged again.

    Raises:
        InputError: there is no recording of funnel-hil.
    """
    return Run(judged_again(str(path), Path(path)))


def diff(*runs: Run | str | Path, out: str | Path | None = None, overwrite: bool = False) -> Diff:
    """Compare recorded runs with the first of them.

    Args:
        runs: two or more folders or MCAP files, or runs that were written or loaded; they may
            differ in everything but their joints.
        out: folder for summary and report; nothing is written without.
        overwrite: replace the results that `out` holds.

    Raises:
        InputError: one of them cannot be read, or they cannot be compared.
    """
    compared = recorded_runs([_recording(run) for run in runs])
    if out is not None:
        with ResultFolder(new_folder(KIND, Path(out), overwrite=overwrite)).lock() as folder:
            write_json(folder.manifest, provenance())
            write_results(folder, diff_results(compared))
    return Diff(compared)


def _recording(run: Run | str | Path) -> Path:
    """Return the recording of a run."""
    place = run.path if isinstance(run, Run) else run
    if not isinstance(place, str | Path):
        raise InputError(
            f"diff: {run!r}: must be a folder, an MCAP file, or a run of simulate(..., out=FOLDER)"
            " or load_run"
        )
    return Path(place)


def _judged(scenario: Scenario) -> JudgedRun:
    with scenario.laws():
        return execute(scenario.setup)
