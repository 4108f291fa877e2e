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
from controller.laws import LAWS
from deploy.cli.common import judging, leave, parse_laws, say_oddities, show_places, watching
from deploy.cli.options import Confirm, Out, Overrides, Overwrite, RequireBounds, ScenarioArgument
from deploy.cli.study.studies import is_study, report_study
from deploy.cli.terminal.progress import CommandProgress
from deploy.cli.terminal.show_run import show_summary
from deploy.comparison.comparison import Comparison, LawRun, load_setups
from deploy.comparison.folder import KIND, ComparisonFolder
from deploy.comparison.recorded import KIND as DIFF
from deploy.comparison.recorded import read_again
from deploy.comparison.settling import SettlingTest, settling_test
from deploy.exit_codes import FAULT, FINISHED
from deploy.processes.program import require_program
from deploy.reports.conclude import conclude, conditions_in
from deploy.reports.confirmation_table import confirmation_tables
from deploy.reports.quantities import RMS_ERROR
from deploy.reports.studies.compare_report import write_comparison_report
from deploy.reports.studies.compare_tables import (
    bounds_sentence,
    joint_table,
    recording_sentences,
    verdict_table,
)
from deploy.reports.tables import number
from deploy.reports.terminal import print_conditions, print_table
from deploy.runs.confirmation import check_confirmable
from deploy.runs.run_folder import (
    ResultFolder,
    RunFolder,
    load_run,
    read_summary,
)
from deploy.runs.simulate import attempt
from deploy.scenario.setup import Setup
from deploy.stop_signals import on_stop, stop_at_once


def compare(
    scenario: ScenarioArgument = "paper_arm",
    laws: Annotated[
        str | None,
        typer.Option("--laws", metavar="A,B,…", help="Laws to compare; all by default."),
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
        comparison = Comparison(_run_all(setups, folder, console, stop, confirms=confirm))
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
    if is_study(run_dir):
        report_study(run_dir, console)
    elif read_summary(run_dir).get("kind") == KIND:
        comparison_folder = ComparisonFolder(run_dir)
        comparison_folder.lock()
        with comparison_folder:
            comparison = comparison_folder.load()
            _conclude_comparison(comparison, comparison_folder, console)
        if any(run.data.damage for run in comparison.runs):
            raise typer.Exit(FAULT)
    elif read_summary(run_dir).get("kind") == DIFF:
        from deploy.cli.study.diff import show_diff  # with all figures

        compared, diff_folder = read_again(run_dir), ResultFolder(run_dir.resolve())
        diff_folder.lock()
        with diff_folder:
            show_diff(compared, diff_folder, console)
    else:
        data, _ = load_run(run_dir)
        folder = RunFolder(run_dir if run_dir.is_dir() else run_dir.parent)
        folder.lock()
        with folder:
            with judging(console, folder):
                summary = conclude(folder, data)
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
    from deploy.benchmarks.bench import run_bench  # imports what nothing else needs

    sections = run_bench(Console(), json_file, quick=quick)
    raise typer.Exit(FINISHED if all(section.ratios for section in sections) else FAULT)


def _run_all(
    setups: list[Setup],
    folder: ComparisonFolder,
    console: Console,
    stop: threading.Event,
    *,
    confirms: bool,
) -> list[LawRun]:
    """Simulate one law after another, until the user sets `stop` by an interrupt."""
    runs = []
    total_s, before_s = sum(setup.scenario.duration_s for setup in setups), 0.0
    with CommandProgress(console, "starting", total_s, "s") as progress:
        for setup in setups:
            law = setup.scenario.controller.name
            known = folder.known(setup)
            if known is not None:
                runs.append(known)
            elif setup.scenario.controller.process is None:
                watch = watching(progress, setup, law, stop, before_s)
                simulation = attempt(setup, watch)
                on_stop(stop.set)
                runs.append(folder.add(simulation))
            else:
                runs.append(folder.add_process(setup, partial(_stop_by, stop)))
            if confirms and not stop.is_set():
                folder.confirm(runs[-1])
            before = "" if known is None else " (from before)"
            progress.say(f"{law}: {bounds_sentence(runs[-1])}{before}")
            before_s += setup.scenario.duration_s
            if stop.is_set():
                break
    return runs


def _settle(
    setups: list[Setup], comparison: Comparison, folder: ComparisonFolder, console: Console
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
    comparison: Comparison, folder: ComparisonFolder, console: Console
) -> None:
    """Write rows, summary and report, and show what came of it."""
    with judging(console, folder):
        folder.conclude(comparison)
        conditions = folder.conditions(comparison)
        write_comparison_report(comparison, folder.report, conditions)
    _show_comparison(console, comparison)
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


def _show_comparison(console: Console, comparison: Comparison) -> None:
    """The result as two tables: what decides, and the RMS errors joint by joint."""
    if not comparison.runs:
        console.print("no law was run")
        return
    print_table(console, verdict_table(comparison))
    print_table(console, joint_table(comparison, RMS_ERROR))
    for table in confirmation_tables([run.summary for run in comparison.runs]):
        print_table(console, table)
    for lack in recording_sentences(comparison.runs):
        console.print(lack, markup=False, highlight=False)
