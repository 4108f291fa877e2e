"""Single runs: simulated, compared, and read back."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from bus_schema.recording.atomic_files import write_json
from deploy.comparison.comparison import Comparison as LawComparison
from deploy.comparison.comparison import LawRun
from deploy.comparison.folder import ComparisonFolder, judged_again
from deploy.comparison.recorded import KIND, recorded_runs
from deploy.processes.network.links import check_link
from deploy.reports.conclude import conclude
from deploy.reports.studies.compare_report import write_comparison_report
from deploy.reports.studies.diff_report import conclude_diff
from deploy.runs.judging.metrics import summarise
from deploy.runs.new_folder import new_folder
from deploy.runs.run_folder import ResultFolder, RunFolder, provenance
from deploy.runs.simulate import attempt
from deploy.runs.simulate import simulate as simulate_setup
from deploy.scenario.study_keys import laws_beside
from funnel_hil.results import Comparison, Diff, Run
from funnel_hil.scenarios import Changes, InputError, Law, Scenario, ScenarioLike


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
        InputError: the scenario cannot be used, or `out` holds results. Whatever a law raises is
            a fault of the run, and no exception.
    """
    given = Scenario(scenario, changes, law)
    check_link(given.setup, one_process=True)
    with given.laws():
        if out is None:
            data = simulate_setup(given.setup).data()
            return Run(data, summarise(data))
        with RunFolder.begin(given.setup, Path(out), overwrite=overwrite) as folder:
            simulation = simulate_setup(given.setup, can_log=folder.can_log)
            data = simulation.data(simulation.write_log(folder.log))
            return Run(data, conclude(folder, data), folder.path)


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
        return Comparison(LawComparison([_judged(each) for each in tried]))
    setups = [each.setup for each in tried]
    with ComparisonFolder.begin(setups, Path(out), overwrite=overwrite) as folder:
        runs = []
        for each in tried:
            with each.laws():
                runs.append(folder.known(each.setup) or folder.add(attempt(each.setup)))
        compared = LawComparison(runs)
        folder.conclude(compared)
        write_comparison_report(compared, folder.report, folder.conditions(compared))
    return Comparison(compared)


def load_run(path: str | Path) -> Run:
    """A recorded run: its folder, or its MCAP file.

    The recording may be anybody's: no law that it names is imported. It is judged again.

    Raises:
        InputError: there is no recording of funnel-hil.
    """
    run = judged_again(str(path), Path(path))
    return Run(run.data, run.summary, Path(path))


def diff(*runs: Run | str | Path, out: str | Path | None = None, overwrite: bool = False) -> Diff:
    """Set recorded runs side by side, the first as what the others are held against.

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
        folder = ResultFolder(new_folder(KIND, Path(out), overwrite=overwrite))
        folder.lock()
        with folder:
            write_json(folder.manifest, provenance())
            conclude_diff(compared, folder)
    return Diff(compared)


def _recording(run: Run | str | Path) -> Path:
    """Where a run was recorded."""
    place = run.path if isinstance(run, Run) else run
    if not isinstance(place, str | Path):
        raise InputError(
            f"diff: {run!r}: must be a folder, an MCAP file, or a run of simulate(..., out=FOLDER)"
            " or load_run"
        )
    return Path(place)


def _judged(scenario: Scenario) -> LawRun:
    with scenario.laws():
        data = attempt(scenario.setup).data()
    return LawRun(scenario.law, data, summarise(data))
