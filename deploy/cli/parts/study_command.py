"""Run or continue a study from a command, and show its results."""

from __future__ import annotations

import contextlib
import threading
from collections.abc import Callable, Iterator
from functools import partial
from typing import TYPE_CHECKING

import typer

from deploy.cli.parts.common import ResultGate, leave, say_warnings, show_results
from deploy.cli.parts.options import GateOptions
from deploy.cli.parts.progress import CommandProgress
from deploy.cli.parts.study_options import WorkerOptions
from deploy.judge.run_rows import Row
from deploy.reports.studies.results import write_study
from deploy.run.confirmation import check_confirmable
from deploy.run.console import Console
from deploy.run.exit_codes import FAULT, INTERRUPTED
from deploy.run.processes.program import require_program
from deploy.run.stop_signals import on_stop
from deploy.scenario.yaml_files import ScenarioError
from deploy.study.execution.runner import Progress
from deploy.study.execution.session import Session, open_session
from deploy.study.study import StudyOfRuns

if TYPE_CHECKING:
    from deploy.study.execution.dask_workers import DaskWorkers  # heavy

_GOES_ON = "{}: repeat the same command to continue."
_AUTHENTICATED = ("tls://", "wss://")
_OPEN_SCHEDULER = (
    "warning: --scheduler {}: anybody who reaches this scheduler can run code on it, on its workers"
    " and here: without TLS, Dask authenticates no client and unpickles any message. Keep it on"
    " 127.0.0.1 or a network of your own, or run it under tls:// (documentation: Run a study"
    " on a cluster)"
)


class RunCounter:
    """Counts the finished runs of one study, or of several in turn, on a progress line."""

    def __init__(self, progress: CommandProgress) -> None:
        self._progress = progress
        self._done = self._before = self._failed = 0
        self._of_others = 0

    def begin(self, later: int) -> None:
        """Begin another study, after which at most `later` runs of others follow."""
        self._of_others = self._done + later

    def done(self, values: Row, at_most: int, before: bool) -> None:
        """A run is done, now or by an earlier command; the study has `at_most` runs in all."""
        self._done += 1
        self._before += before
        self._failed += values["error"] is not None
        notes = {
            "runs were there from before": self._before,
            "ended by a fault or reflex": self._failed,
        }
        note = ", ".join(f"{count} {what}" for what, count in notes.items() if count)
        if before:
            self._progress.skip_to(self._before)
        self._progress.update(self._done, total=self._of_others + at_most, note=note)


def run_study(study: StudyOfRuns, options: WorkerOptions, *, require_bounds: bool = False) -> None:
    """Run or continue a study, show its results, and end with its exit code.

    Args:
        study: the study.
        options: workers, folder and gate.
        require_bounds: whether each run must keep its bounds.
    """
    quantity, pattern = (getattr(study.definition, key, None) for key in ("quantity", "pattern"))
    console = Console()
    gate = None
    if isinstance(options, GateOptions):
        gate = ResultGate(
            options, study.definition.name, study.unit, study.tested_with, study.kind, quantity,
            patterns=pattern is not None, furthest=study.furthest,
        )  # fmt: skip
    say_warnings(*study.bases, more=[f"not tested: {each}" for each in study.doubts_before])
    with carried_out(study, options, console, threading.Event()) as done:
        results = show_results(console, done.folder, lambda: write_study(study, done.folder))
    if not results.summary["completed"]:
        console.print(_GOES_ON.format(done.lost or "stopped"), markup=False)
        raise typer.Exit(INTERRUPTED if done.is_interrupted else FAULT)
    runs, rows = results.runs, done.folder.rows
    whole = all(run.summary["completed"] for run in runs) and any(not r["error"] for r in rows)
    kept = not require_bounds or all(run.kept_bounds for run in runs)
    is_passed = not (whole and gate) or gate.is_passed(results.summary, console, done.folder.note)
    leave(interrupted=False, whole=whole, kept=kept and is_passed)


class SharedWorkers(contextlib.ExitStack):
    """Worker processes that several studies of one command use in turn; the first starts them."""

    _workers: DaskWorkers | None = None

    @contextlib.contextmanager
    def borrowed(self, start: Callable[[], DaskWorkers]) -> Iterator[DaskWorkers]:
        """Return the workers for one study; `start` starts them if there are none."""
        if self._workers is None:
            self._workers = self.enter_context(start())
        try:
            yield self._workers
        finally:
            self._workers.forget()


@contextlib.contextmanager
def carried_out(
    study: StudyOfRuns, options: WorkerOptions, console: Console, stop: threading.Event,
    shared: SharedWorkers | None = None, counter: RunCounter | None = None,
) -> Iterator[Session]:  # fmt: skip
    """Do the runs that the folder of a study lacks, with progress; it is locked meanwhile.

    Args:
        study: the study.
        options: workers and folder.
        console: where to show the progress.
        stop: set to end early.
        shared: workers, if other studies with the same laws use them too.
        counter: of a progress line that other studies use too, whose runs it counts.
    """
    start = _workers(study, options)
    with open_session(
        study, start if shared is None else partial(shared.borrowed, start), options.out,
        _progress(console, study, options, stop, counter),
        overwrite=options.overwrite, is_elsewhere=options.scheduler is not None, stop=stop,
    ) as done:  # fmt: skip
        if done.folder.unseen:
            console.print(done.folder.unseen, markup=False, soft_wrap=True)
        yield done


def _workers(study: StudyOfRuns, options: WorkerOptions) -> Callable[[], DaskWorkers]:
    """Return what starts the workers of a study, after checking that its scenarios can run."""
    if options.workers is not None and options.scheduler is not None:
        raise ScenarioError("--workers and --scheduler: a cluster has its own number of workers")
    from deploy.study.execution.dask_workers import DaskWorkers  # heavy

    for each in study.variants:
        if options.scheduler is None:  # else it has to be on the hosts of the cluster
            require_program(each)
        if study.definition.confirm:
            check_confirmable(each)
    return partial(DaskWorkers, options.workers, options.scheduler, study.laws)


@contextlib.contextmanager
def _progress(
    console: Console, study: StudyOfRuns, options: WorkerOptions, stop: threading.Event,
    counter: RunCounter | None = None,
) -> Iterator[Progress]:  # fmt: skip
    """Show the progress of a study, and handle requests to stop it."""
    scheduler = options.scheduler
    if scheduler is not None and not scheduler.startswith(_AUTHENTICATED):
        warning = _OPEN_SCHEDULER.format(scheduler)
        Console(stderr=True).print(warning, markup=False, soft_wrap=True)
    on_stop(stop.set)
    if counter is not None:
        yield counter.done
        return
    with CommandProgress(console, study.definition.name, study.at_most, "runs") as shown:
        yield RunCounter(shown).done
