"""Commands for recorded runs: `report`, `diff` and `replay`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer
from rich.text import Text

from bus_schema.recording.atomic_files import write_json
from controller.laws.custom import is_custom
from deploy.cli.common import conclude
from deploy.cli.options import NoReport, Out, Overwrite
from deploy.judge.arithmetic import difference_of_arithmetic
from deploy.judge.bounds import all_damage
from deploy.judge.run_data import RunData
from deploy.reports.data_sheet_results import sheet_again
from deploy.reports.kinds import kind_of
from deploy.reports.results import (
    Results,
    comparison_results,
    diff_results,
    study_results,
    write_results,
    write_run,
    write_study,
)
from deploy.reports.verdict_texts import PARTIAL, damaged
from deploy.run.console import Console
from deploy.run.execute import JudgedRun
from deploy.run.exit_codes import FAULT, FINISHED
from deploy.run.new_folder import new_folder
from deploy.run.replay import Replay
from deploy.run.replay import replay as replay_run
from deploy.run.run_folder import (
    ResultFolder,
    RunFolder,
    load_run,
    provenance,
    read_manifest,
    read_summary,
)
from deploy.run.stop_signals import WITHIN_S, stop_at_once
from deploy.scenario.yaml_files import ScenarioError, naming
from deploy.study.comparison.comparison import KIND as COMPARISON
from deploy.study.comparison.recorded import KIND as DIFF
from deploy.study.comparison.recorded import read_again, recorded_runs
from deploy.study.folder import STUDY_FILE, StudyFolder, changes_since, read_study
from deploy.study.runner import retrace


def diff(
    runs: Annotated[
        list[Path], typer.Argument(metavar="RUN RUN…", help="Folders or MCAP files of runs.")
    ],
    out: Out = None,
    overwrite: Overwrite = False,
    no_report: NoReport = False,
) -> None:
    """Compare recorded runs: real time and lockstep, two laws, two versions.

    All runs are compared with the first. They may differ in everything but their joints.
    """
    compared = recorded_runs(runs)
    with ResultFolder(new_folder(DIFF, out, overwrite=overwrite)).lock() as folder:
        write_json(folder.manifest, provenance())
        results = diff_results(compared)
        conclude(
            Console(), folder, lambda: write_results(folder, results, draws_report=not no_report)
        )


def report(
    run_dir: Annotated[
        Path, typer.Argument(help="Folder of a run, a comparison, a study or a data sheet.")
    ],
) -> None:
    """Evaluate recorded results again, and write summary.json and report.html.

    A damaged recording is evaluated as far as it can be read, with exit code 1.
    """
    again = _AGAIN.get(kind_of(read_summary(run_dir)).name)
    if again is None:
        again = _study_again if (run_dir / STUDY_FILE).is_file() else _run_again
    raise typer.Exit(FAULT if again(run_dir, Console()).is_damaged else FINISHED)


def _run_again(path: Path, console: Console) -> Results:
    run = JudgedRun(path.name, load_run(path)[0], path=path)
    with RunFolder(path if path.is_dir() else path.parent).lock() as folder:
        return conclude(console, folder, lambda: write_run(folder, run))


def _laws_again(path: Path, console: Console) -> Results:
    """Judge the recordings of a comparison; its study may have changed, or be of an old version."""
    with ResultFolder(path.resolve()).lock() as folder:

        def judge() -> Results:
            results, _ = comparison_results(folder, read_summary(folder.path))
            return write_results(folder, results)

        return conclude(console, folder, judge)


def _diff_again(path: Path, console: Console) -> Results:
    results = diff_results(read_again(path))
    with ResultFolder(path.resolve()).lock() as folder:
        return conclude(console, folder, lambda: write_results(folder, results))


def _study_again(path: Path, console: Console) -> Results:
    """Judge the rows of a study; show its earlier summary if its scenarios have changed."""
    study = read_study(path)
    with StudyFolder(path.resolve(), study).lock() as folder:
        changed, summary = "; ".join(changes_since(study, folder.path)), read_summary(folder.path)
        if not changed:
            retrace(study, folder)
            return conclude(console, folder, lambda: write_study(study, folder))
        if "conditions" not in summary:
            raise ScenarioError(
                f"{folder.path}: {changed}: must be as it was, as no summary is there"
            )
        console.print(f"{changed}: this is the summary of before", markup=False, soft_wrap=True)
        results = study_results(summary, folder)
        return conclude(console, folder, lambda: write_results(folder, results))


def _sheet_again(path: Path, console: Console) -> Results:
    with ResultFolder(path.resolve()).lock() as folder:
        return conclude(console, folder, lambda: sheet_again(folder))


_AGAIN = {COMPARISON: _laws_again, DIFF: _diff_again, "datasheet": _sheet_again}
"""Results of several recordings, by kind."""


def replay(
    run_dir: Annotated[Path, typer.Argument(help="Folder of a recorded run.")],
    allow_custom_law: Annotated[
        bool,
        typer.Option("--allow-custom-law", help="Run the custom law that the recording names."),
    ] = False,
) -> None:
    """Feed a recorded run to its law again, and compare the torques bit for bit."""
    data, contents = load_run(run_dir)
    _require_replayable(run_dir, data, allow_custom_law=allow_custom_law)
    stop_at_once(WITHIN_S, may_hold_lock=is_custom(data.setup.scenario.controller.law))
    with naming(run_dir):
        master_skips = data.setup.link_kind.controller_leads and data.clock == "realtime"
        result = replay_run(data.setup, contents, master_skips=master_skips)
    stop_at_once()
    recorded = read_manifest(run_dir if run_dir.is_dir() else run_dir.parent)
    damage = all_damage(data)
    _show_replay(result, data, damage, difference_of_arithmetic(recorded, provenance()))
    raise typer.Exit(FINISHED if result.is_identical and not damage else FAULT)


def _require_replayable(run_dir: Path, data: RunData, *, allow_custom_law: bool) -> None:
    """Check that the law of a recording exists and may run."""
    law = data.setup.scenario.controller.law
    if data.setup.scenario.controller.process is not None:
        raise ScenarioError(
            f"{run_dir}: {data.controller}: is not a law that funnel-hil can replay"
        )
    if is_custom(law) and not allow_custom_law:
        raise ScenarioError(
            f"{run_dir}: controller.law = {law!r}: is not a shipped law; --allow-custom-law runs"
            " the module or program of that name, which is code of the user"
        )


def _show_replay(result: Replay, data: RunData, damage: list[str], difference: str) -> None:
    console = Console()
    if damage:
        console.print(damaged(damage), markup=False)
    elif not data.complete:
        console.print(PARTIAL)
    console.print(f"recorded {result.recorded} commands, digest {result.recorded_digest}")
    console.print(f"replayed {result.replayed} commands, digest {result.digest}")
    if result.failure:
        console.print(f"the replay stopped early: {result.failure}", markup=False, highlight=False)
    if not result.is_identical:
        from_command = f" from command {result.first_difference} on"
        console.print(Text.assemble(("different", "bold red"), from_command))
        if difference:
            console.print(difference, markup=False, highlight=False)
        return
    until = " as far as can be read" if damage else " until it failed" * bool(result.failure)
    console.print(Text.assemble(("identical", "bold green"), until))
