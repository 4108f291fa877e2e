"""The commands that experiment with runs and look back at them."""

from __future__ import annotations

import threading
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console

from bus_schema.errors import Stopped
from bus_schema.recording.atomic_files import write_json
from controller.laws import LAWS
from deploy.cli.common import judging, leave, parse_laws, say_oddities, show_places, watching
from deploy.cli.options import (
    Confirm,
    NoReport,
    Out,
    Overrides,
    Overwrite,
    RequireBounds,
    ScenarioArgument,
)
from deploy.cli.study.studies import report_study
from deploy.cli.terminal.progress import CommandProgress
from deploy.cli.terminal.show_run import show_summary
from deploy.reports.comparison_tables import (
    difference_table,
    law_table,
    recorded_joint_tables,
    recorded_table,
    recorded_timing_table,
    verdict_table,
)
from deploy.reports.quantities import RMS_ERROR
from deploy.reports.results import conditions_in, write_diff_results, write_run_results
from deploy.reports.run_reports import write_comparison_report
from deploy.reports.run_tables import confirmation_tables
from deploy.reports.tables import number
from deploy.reports.terminal import print_conditions, print_table
from deploy.reports.verdict import bounds_sentence, recording_sentences, verdict_on_runs
from deploy.run.confirmation import check_confirmable
from deploy.run.execute import How, InProcess, JudgedRun, Lockstep
from deploy.run.exit_codes import FAULT, FINISHED
from deploy.run.new_folder import new_folder
from deploy.run.processes.program import require_program
from deploy.run.run_folder import ResultFolder, RunFolder, load_run, provenance, read_summary
from deploy.run.stop_signals import on_stop, stop_at_once
from deploy.scenario.setup import Setup
from deploy.study.comparison.comparison import KIND, ComparedRuns, ComparisonFolder, load_setups
from deploy.study.comparison.recorded import KIND as DIFF
from deploy.study.comparison.recorded import RecordedRuns, read_again, recorded_runs
from deploy.study.comparison.settling import SettlingTest, settling_test
from deploy.study.folder import STUDY_FILE


def compare(
    scenario: ScenarioArgument = "paper_arm",
    laws: Annotated[
        str | None, typer.Option(metavar="A,B,…", help="Laws to compare; all by default.")
    ] = None,
    settling: Annotated[
        bool,
        typer.Option("--settling", help="Also measure settling times from offsets of up to 1 rad."),
    ] = False,
    overrides: Overrides = None,
    out: Out = None,
    overwrite: Overwrite = False,
    require_bounds: RequireBounds = False,
    confirm: Confirm = False,
) -> None:
    """Run a scenario under several laws in virtual time, and set their results side by side."""
    setups = load_setups(scenario, overrides or [], parse_laws(laws))
    say_oddities(setups[0])
    for setup in setups:
        require_program(setup)
        if confirm:
            check_confirmable(setup)
    folder = ComparisonFolder.begin(setups, out, overwrite=overwrite)
    with folder:
        console, stop = Console(), threading.Event()
        comparison = ComparedRuns(_run_all(setups, folder, console, stop, confirms=confirm))
        if settling and not stop.is_set():
            try:
                stop_at_once()
                _settle(setups, comparison, folder, console)
            except Stopped:
                stop.set()
        interrupted = stop.is_set()
        _conclude_comparison(comparison, folder, console)
        leave(
            interrupted=interrupted,
            whole=all(run.summary["completed"] for run in comparison.runs),
            kept=all(run.kept_bounds for run in comparison.runs) or not require_bounds,
        )


def diff(
    runs: Annotated[
        list[Path], typer.Argument(metavar="RUN RUN…", help="Folders or MCAP files of runs.")
    ],
    out: Out = None,
    overwrite: Overwrite = False,
    no_report: NoReport = False,
) -> None:
    """Set recorded runs side by side: real time and lockstep, two laws, two versions.

    The first is what the others are held against. They may differ in everything but their joints.
    """
    compared = recorded_runs(runs)
    with ResultFolder(new_folder(DIFF, out, overwrite=overwrite)).lock() as folder:
        write_json(folder.manifest, provenance())
        _show_diff(compared, folder, Console(), draws_report=not no_report)


def report(
    run_dir: Annotated[
        Path, typer.Argument(help="Folder of a recorded run, a comparison, a sweep or margins.")
    ],
) -> None:
    """Judge what was recorded again: summary.json and report.html of what a folder holds.

    A damaged recording is judged as far as it can be read, and
    ends with exit code 1.
    """
    console = Console()
    if (run_dir / STUDY_FILE).is_file():
        report_study(run_dir, console)
    elif read_summary(run_dir).get("kind") == KIND:
        with ComparisonFolder(run_dir).lock() as of_laws:
            comparison = of_laws.load()
            _conclude_comparison(comparison, of_laws, console)
        if any(run.data.damage for run in comparison.runs):
            raise typer.Exit(FAULT)
    elif read_summary(run_dir).get("kind") == DIFF:
        compared = read_again(run_dir)
        with ResultFolder(run_dir.resolve()).lock() as of_runs:
            _show_diff(compared, of_runs, console)
    else:
        data, _ = load_run(run_dir)
        with RunFolder(run_dir if run_dir.is_dir() else run_dir.parent).lock() as folder:
            with judging(console, folder):
                summary = write_run_results(folder, data)
            show_summary(console, data, summary, conditions_in(folder, data))
            console.print(f"report: {folder.report}", soft_wrap=True)
        raise typer.Exit(FAULT if data.damage else FINISHED)


def bench(
    json_file: Annotated[
        Path | None, typer.Option("--json", metavar="FILE", help="Write the numbers to a file.")
    ] = None,
    quick: Annotated[
        bool, typer.Option("--quick", help="Fewer and shorter repetitions: a first impression.")
    ] = False,
) -> None:
    """Measure what things cost on this machine, as ratios of medians side by side."""
    from deploy.bench.bench import run_bench  # imports what nothing else needs

    sections = run_bench(Console(), json_file, quick=quick)
    raise typer.Exit(FINISHED if all(section.ratios for section in sections) else FAULT)


def _show_diff(
    compared: RecordedRuns, folder: ResultFolder, console: Console, *, draws_report: bool = True
) -> None:
    """Write summary and report, and show what came of it."""
    write_diff_results(compared, folder, draws_report=draws_report)
    tables = [*recorded_joint_tables(compared), recorded_timing_table(compared)]
    tables += [recorded_table(compared)]
    tables += [difference_table(compared)] if compared.differing else []
    for table in tables:
        print_table(console, table)
    verdict = verdict_on_runs(compared)
    console.print(verdict.headline, style="bold", markup=False)
    for reason in verdict.reasons:
        console.print(reason, markup=False, highlight=False)
    show_places(console, folder)


def _run_all(
    setups: list[Setup],
    folder: ComparisonFolder,
    console: Console,
    stop: threading.Event,
    *,
    confirms: bool,
) -> list[JudgedRun]:
    """Simulate one law after another, until the user sets `stop` by an interrupt."""
    runs = []
    total_s, before_s = sum(setup.scenario.duration_s for setup in setups), 0.0
    with CommandProgress(console, "starting", total_s, "s") as progress:
        for setup in setups:
            law = setup.scenario.controller.name
            watch = watching(progress, setup, law, stop, before_s)
            how: How = InProcess(watch, partial(on_stop, stop.set))
            if setup.scenario.controller.process is not None:
                how = Lockstep(partial(_stop_by, stop))
            known = folder.known(setup)
            runs.append(known or folder.add(setup, how))
            if confirms and not stop.is_set():
                folder.confirm(runs[-1])
            before = "" if known is None else " (from before)"
            progress.say(f"{law}: {bounds_sentence(runs[-1])}{before}")
            before_s += setup.scenario.duration_s
            if stop.is_set():
                break
    return runs


def _settle(
    setups: list[Setup], comparison: ComparedRuns, folder: ComparisonFolder, console: Console
) -> None:
    """Measure how the laws settle, and say it of each."""
    earlier = folder.earlier_settling()
    for setup in setups:
        if setup.scenario.controller.process is not None:
            continue  # it has no bound, and each of its starts would be a run of its own
        law = setup.scenario.controller.law
        test = (law in LAWS and earlier.get(law)) or settling_test(setup)
        comparison.settling.append(test)
        console.print(settling_sentence(test), markup=False, highlight=False)


def _stop_by(stop: threading.Event, request_stop: Callable[[], None]) -> None:
    """Have an interrupt stop a run by `request_stop`, and set `stop`."""

    def both() -> None:
        stop.set()
        request_stop()

    on_stop(both)


def _conclude_comparison(
    comparison: ComparedRuns, folder: ComparisonFolder, console: Console
) -> None:
    """Write rows, summary and report, and show what came of it."""
    with judging(console, folder):
        conditions = folder.conclude(comparison)
        write_comparison_report(comparison, folder.report, conditions)
    confirmed = confirmation_tables([run.summary for run in comparison.runs])
    for table in (verdict_table(comparison), law_table(comparison, RMS_ERROR), *confirmed):
        print_table(console, table)
    for lack in recording_sentences(comparison.runs):
        console.print(lack, markup=False, highlight=False)
    print_conditions(console, conditions)
    show_places(console, folder)


def settling_sentence(test: SettlingTest) -> str:
    """How a law settled from near and far."""
    times = [start.settling_time_s for start in test.starts]
    known = [time for time in times if time is not None]
    farthest = number(max((start.distance_rad for start in test.starts), default=None))
    bound = "" if test.bound_s is None else f", bound {number(test.bound_s)} s"
    slowest = f", at most {number(max(known))} s" if known else ""
    return (
        f"{test.law}: settled from {len(known)} of {len(times)} starts of up to {farthest} rad"
        f"{slowest}{bound}"
    )
