"""The commands that do many runs: sweeps and margins."""

from __future__ import annotations

import inspect
import threading
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.console import Console

from deploy.cli.common import judging, say_oddities, show_places
from deploy.cli.options import Confirm, Out, Overrides, Overwrite
from deploy.cli.study.margin_options import (
    MarginOptions,
    Plants,
    PlantSeed,
    Scheduler,
    UncertaintyOption,
    WorkerCount,
    definition_with,
)
from deploy.cli.terminal.progress import CommandProgress
from deploy.exit_codes import FAULT, FINISHED, INTERRUPTED
from deploy.processes.program import require_program
from deploy.reports.confirmation_table import confirmation_tables
from deploy.reports.studies.conclude import conclude_study
from deploy.reports.studies.robustness_tables import (
    losses_table,
    robustness_table,
    write_robustness_table,
)
from deploy.reports.studies.study_tables import (
    held_again,
    margin_table,
    point_table,
    write_margin_table,
)
from deploy.reports.terminal import print_conditions, print_table
from deploy.runs.confirmation import check_confirmable
from deploy.runs.run_rows import Row
from deploy.scenario.yaml_files import ScenarioError, find_yaml, parse_override, read_yaml
from deploy.stop_signals import on_stop
from deploy.study.conduct import Workers, carry_out, retrace
from deploy.study.folder import STUDY_FILE, StudyFolder, create_folder, find_folder, read_study
from deploy.study.robustness import margin_study
from deploy.study.study import SHIPPED, Study, is_sweep
from deploy.study.sweep import load_sweep

_SHOWN_POINTS = 40
_AUTHENTICATED = ("tls://", "wss://")
_OPEN_SCHEDULER = (
    "warning: --scheduler {}: anybody who reaches this scheduler can run code on it, on its workers"
    " and here: without TLS, Dask asks nobody who they are and unpickles what comes. Keep it on"
    " 127.0.0.1 or a network of your own, or run it under tls:// (deploy/README.md, Sweeps and"
    " margins)"
)
_TABLES = {"margin": write_margin_table, "robustness": write_robustness_table}
"""What writes the table for documents, by kind of study."""


def sweep(
    definition: Annotated[
        str, typer.Argument(metavar="SWEEP", help="A sweep file, or the name of a shipped one.")
    ],
    plants: Plants = None,
    plant_seed: PlantSeed = None,
    uncertainty: UncertaintyOption = None,
    overrides: Overrides = None,
    workers: WorkerCount = None,
    scheduler: Scheduler = None,
    out: Out = None,
    overwrite: Overwrite = False,
    confirm: Confirm = False,
) -> None:
    """Run every point of a grid with every seed, on all cores or a Dask cluster.

    With --plants every point with each of so many uncertain plants. Interrupted or killed, the same
    command goes on where it stopped.
    """
    given = {
        "plants": plants, "plant_seed": plant_seed, "uncertainty": uncertainty,
        "confirm": confirm or None,
    }  # fmt: skip
    more = {key: value for key, value in given.items() if value is not None}
    fixed = dict(map(parse_override, overrides or []))
    _conduct(load_sweep(definition, more, fixed), workers, scheduler, out, overwrite=overwrite)


def margin(**words: Any) -> None:
    """Find the largest delay, or anything else, at which each law keeps its bounds.

    Bracketing and bisection, from several starts with several seeds; with --plants the share of
    uncertain plants that keep them, at each of --values. Interrupted or killed, the same command
    goes on where it stopped.
    """
    options = MarginOptions(**words)
    path, values = Path("margin"), dict[str, Any]()
    if options.study is not None:
        path = find_yaml(options.study, SHIPPED, fits=lambda file: not is_sweep(file))
        values = read_yaml(path)
    values = definition_with(options, values)
    _conduct(
        margin_study(values, path), options.workers, options.scheduler, options.out,
        overwrite=options.overwrite,
    )  # fmt: skip


vars(margin)["__signature__"] = inspect.signature(MarginOptions, eval_str=True)  # for typer


class RunCounter:
    """Counts the runs of a study on a progress."""

    def __init__(self, progress: CommandProgress) -> None:
        self._progress = progress
        self._done = self._before = self._failed = 0

    def done(self, values: Row, expected: int, *, before: bool) -> None:
        """A run is done, now or by an earlier command; `expected` runs there will be in all."""
        self._done += 1
        self._before += before
        self._failed += values["error"] is not None
        notes = {"runs were there from before": self._before, "failed": self._failed}
        note = ", ".join(f"{count} {what}" for what, count in notes.items() if count)
        if before:
            self._progress.skip_to(self._before)
        self._progress.update(self._done, total=expected, note=note)


def is_study(path: Path) -> bool:
    """Whether a folder holds a sweep or margins."""
    return (path / STUDY_FILE).is_file()


def report_study(path: Path, console: Console) -> None:
    """Judge the rows of a study again, and write its summary and report."""
    study = read_study(path)
    folder = StudyFolder(path.resolve(), study)
    folder.lock()
    with folder:
        retrace(study, folder)
        _conclude(study, folder, console)


def _conduct(
    study: Study, workers: int | None, scheduler: str | None, out: Path | None, *, overwrite: bool
) -> None:
    """Carry a study out, or on, and show what came of it."""
    if workers is not None and scheduler is not None:
        raise ScenarioError("--workers and --scheduler: a cluster has its own number of workers")
    if scheduler is None:  # else it has to be on the hosts of the cluster
        for base in study.bases:
            require_program(base)
    from deploy.study.dask_workers import DaskWorkers  # heavy

    if study.definition.confirm:
        for base in study.bases:
            check_confirmable(base)
    say_oddities(*study.bases)
    console, stop = Console(), threading.Event()
    path = None if overwrite else find_folder(study, out)
    with DaskWorkers(workers, scheduler, study.laws) as team:
        if scheduler is not None and not scheduler.startswith(_AUTHENTICATED):
            warning = _OPEN_SCHEDULER.format(scheduler)
            Console(stderr=True).print(warning, markup=False, soft_wrap=True)
        folder = StudyFolder(path or create_folder(study, out, overwrite=overwrite), study)
        folder.lock()
        with folder:
            folder.become()
            lost = _carry_out(study, team, folder, console, stop)
            completed = _conclude(study, folder, console)
    if completed:
        raise typer.Exit(FINISHED if _has_results(folder) else FAULT)
    reason = f"{lost}; the" if lost else "The"
    console.print(f"{reason} same command goes on from here.", markup=False)
    raise typer.Exit(INTERRUPTED if stop.is_set() and not lost else FAULT)


def _carry_out(
    study: Study, team: Workers, folder: StudyFolder, console: Console, stop: threading.Event
) -> Exception | None:
    """Do the runs that are not done yet, or as many as come before a request to stop.

    Returns:
        How the cluster was lost; None if it was not.
    """
    from deploy.study.dask_workers import ClusterLostError  # heavy

    on_stop(stop.set)
    with CommandProgress(console, study.definition.name, study.expected, "runs") as progress:
        try:
            carry_out(study, team, folder, RunCounter(progress), stop)
        except ClusterLostError as error:
            return error
        finally:
            folder.flush()
    return None


def _conclude(study: Study, folder: StudyFolder, console: Console) -> bool:
    """Write table, summary and report; whether the study is complete."""
    with judging(console, folder):
        summary = conclude_study(study, folder)
    show_study(console, summary)
    write_table = _TABLES.get(study.kind)
    if write_table is not None:
        write_table(summary, folder.path / "table.md")
        console.print(f"table:   {folder.path / 'table.md'}", soft_wrap=True)
    show_places(console, folder)
    return bool(summary["completed"])


def _has_results(folder: StudyFolder) -> bool:
    """Whether a run came to anything."""
    return any(row["error"] is None for row in folder.rows)


def show_study(console: Console, summary: dict[str, Any]) -> None:
    """The result as a table."""
    if summary["kind"] == "margin":
        print_table(console, margin_table(summary))
        for sentence in held_again(summary):
            console.print(sentence, markup=False)
    elif summary["kind"] == "robustness":
        for table in (robustness_table(summary), losses_table(summary)):
            print_table(console, table)
    else:
        table = point_table(summary)
        print_table(console, replace(table, rows=table.rows[:_SHOWN_POINTS]))
        for keys in summary.get("without_effect", ()):
            said = f"warning: {keys}: none of its values changed any result of a run"
            console.print(said, markup=False, soft_wrap=True)
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
