"""The commands that do many runs: sweeps and margins."""

from __future__ import annotations

import threading
from dataclasses import replace
from pathlib import Path
from typing import Any

import typer
from rich.console import Console

from deploy.cli.common import judging, say_oddities, show_places
from deploy.cli.options import taking
from deploy.cli.study.margin_options import (
    MarginOptions,
    StudyOptions,
    SweepOptions,
    definition_with,
)
from deploy.cli.terminal.progress import CommandProgress
from deploy.judge.run_rows import Row
from deploy.reports.results import write_study_results
from deploy.reports.run_tables import confirmation_tables
from deploy.reports.study_tables import (
    losses_table,
    margin_table,
    point_table,
    robustness_table,
    write_study_table,
)
from deploy.reports.study_texts import sentences
from deploy.reports.terminal import print_conditions, print_table
from deploy.run.confirmation import check_confirmable
from deploy.run.exit_codes import FAULT, FINISHED, INTERRUPTED
from deploy.run.processes.program import require_program
from deploy.run.run_folder import read_summary
from deploy.run.stop_signals import on_stop
from deploy.scenario.yaml_files import ScenarioError, find_yaml, read_yaml
from deploy.study.folder import StudyFolder, changes_since, create_folder, find_folder, read_study
from deploy.study.robustness import margin_study
from deploy.study.runner import carry_out, retrace
from deploy.study.study import SHIPPED, StudyOfRuns, is_sweep
from deploy.study.sweep import load_sweep

_SHOWN_POINTS = 40
_AUTHENTICATED = ("tls://", "wss://")
_OPEN_SCHEDULER = (
    "warning: --scheduler {}: anybody who reaches this scheduler can run code on it, on its workers"
    " and here: without TLS, Dask asks nobody who they are and unpickles what comes. Keep it on"
    " 127.0.0.1 or a network of your own, or run it under tls:// (documentation: Run a study"
    " on a cluster)"
)


@taking(SweepOptions)
def sweep(options: SweepOptions) -> None:
    """Run every point of a grid with every seed, on all cores or a Dask cluster.

    With --plants every point with each of so many uncertain plants. Interrupted or killed, the same
    command goes on where it stopped.
    """
    _conduct(load_sweep(options.sweep, options.definition(), options.fixed()), options)


@taking(MarginOptions)
def margin(options: MarginOptions) -> None:
    """Find the largest delay, or anything else, at which each law keeps its bounds.

    Bracketing and bisection, from several starts with several seeds; with --plants the share of
    uncertain plants that keep them, at each of --values. Interrupted or killed, the same command
    goes on where it stopped.
    """
    path, values = Path("margin"), dict[str, Any]()
    if options.study is not None:
        path = find_yaml(options.study, SHIPPED, fits=lambda file: not is_sweep(file))
        values = read_yaml(path)
    _conduct(margin_study(definition_with(options, values), path), options)


class RunCounter:
    """Counts the runs of a study on a progress."""

    def __init__(self, progress: CommandProgress) -> None:
        self._progress = progress
        self._done = self._before = self._failed = 0

    def done(self, values: Row, expected: int, before: bool) -> None:
        """A run is done, now or by an earlier command; `expected` runs there will be in all."""
        self._done += 1
        self._before += before
        self._failed += values["error"] is not None
        notes = {"runs were there from before": self._before, "failed": self._failed}
        note = ", ".join(f"{count} {what}" for what, count in notes.items() if count)
        if before:
            self._progress.skip_to(self._before)
        self._progress.update(self._done, total=expected, note=note)


def report_study(path: Path, console: Console) -> None:
    """Judge the rows of a study again, and write its summary and report."""
    study = read_study(path)
    with StudyFolder(path.resolve(), study).lock() as folder:
        changed = changes_since(study, folder.path)
        if not changed:
            retrace(study, folder)
            _conclude(study, folder, console)
            return
        from deploy.reports.study_report import write_study_report  # with all figures

        said, summary = "; ".join(changed), read_summary(folder.path)
        if "conditions" not in summary:
            raise ScenarioError(f"{folder.path}: {said}: must be as it was, as no summary is there")
        console.print(f"{said}: this is the summary of before", markup=False, soft_wrap=True)
        with judging(console, folder):
            write_study_report(summary, folder)
        _show(summary, folder, console)


def _conduct(study: StudyOfRuns, options: StudyOptions) -> None:
    """Carry a study out, or on, and show what came of it."""
    scheduler, out, overwrite = options.scheduler, options.out, options.overwrite
    if options.workers is not None and scheduler is not None:
        raise ScenarioError("--workers and --scheduler: a cluster has its own number of workers")
    from deploy.study.dask_workers import ClusterLostError, DaskWorkers  # heavy

    for base in study.bases:
        if scheduler is None:  # else it has to be on the hosts of the cluster
            require_program(base)
        if study.definition.confirm:
            check_confirmable(base)
    say_oddities(*study.bases)
    console, stop = Console(), threading.Event()
    path = None if overwrite else find_folder(study, out)
    with DaskWorkers(options.workers, scheduler, study.laws) as team:
        if scheduler is not None and not scheduler.startswith(_AUTHENTICATED):
            warning = _OPEN_SCHEDULER.format(scheduler)
            Console(stderr=True).print(warning, markup=False, soft_wrap=True)
        path = path or create_folder(study, out, overwrite=overwrite)
        with StudyFolder(path, study).lock() as folder:
            folder.become()
            on_stop(stop.set)
            lost = None
            with CommandProgress(console, study.definition.name, study.expected, "runs") as shown:
                try:
                    carry_out(study, team, folder, stop, RunCounter(shown).done)
                except ClusterLostError as error:
                    lost = error
            completed = _conclude(study, folder, console)
    if completed:
        has_results = any(row["error"] is None for row in folder.rows)
        raise typer.Exit(FINISHED if has_results else FAULT)
    reason = f"{lost}; the" if lost else "The"
    console.print(f"{reason} same command goes on from here.", markup=False)
    raise typer.Exit(INTERRUPTED if stop.is_set() and not lost else FAULT)


def _conclude(study: StudyOfRuns, folder: StudyFolder, console: Console) -> bool:
    """Write table, summary and report; whether the study is complete."""
    with judging(console, folder):
        summary = write_study_results(study, folder)
    _show(summary, folder, console)
    return bool(summary["completed"])


def _show(summary: dict[str, Any], folder: StudyFolder, console: Console) -> None:
    """Show what came of a study, and write its table for documents."""
    show_study(console, summary)
    if summary["kind"] != "sweep":
        write_study_table(summary, folder.path / "table.md")
        console.print(f"table:   {folder.path / 'table.md'}", soft_wrap=True)
    show_places(console, folder)


def show_study(console: Console, summary: dict[str, Any]) -> None:
    """The result as a table."""
    if summary["kind"] == "margin":
        print_table(console, margin_table(summary))
    elif summary["kind"] == "robustness":
        for table in (robustness_table(summary), losses_table(summary)):
            print_table(console, table)
    else:
        table = point_table(summary)
        print_table(console, replace(table, rows=table.rows[:_SHOWN_POINTS]))
        for keys in summary.get("without_effect", ()):
            said = f"warning: {keys}: none of its values changed any result of a run"
            console.print(said, markup=False, soft_wrap=True)
    for sentence in sentences(summary):
        console.print(sentence, markup=False)
    for table in confirmation_tables([summary]):
        print_table(console, table)
    hidden = len(summary.get("points", ())) - _SHOWN_POINTS
    if hidden > 0:
        console.print(f"{hidden} more points are in the report")
    print_conditions(console, summary.get("conditions", {}))
    if summary["runs_failed"]:
        count = f"{summary['runs_failed']} of {summary['runs']}"
        console.print(f"[bold red]{count} runs failed[/]; their rows say why. The commonest error:")
        console.print(summary["commonest_error"], markup=False, soft_wrap=True)
