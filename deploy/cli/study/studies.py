"""The commands `compare`, `sweep` and `margin`."""

from __future__ import annotations

import contextlib
import threading
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import typer
from rich.text import Text

from deploy.cli.common import CommandGate, judging, leave, say_oddities, show_places
from deploy.cli.options import taking
from deploy.cli.study.margin_options import (
    CompareOptions,
    MarginOptions,
    StudyOptions,
    SweepOptions,
    TuneOptions,
    WorkerOptions,
    definition_with,
)
from deploy.cli.terminal.progress import CommandProgress
from deploy.judge.run_rows import Row
from deploy.reports.comparison_tables import law_table, verdict_table
from deploy.reports.gate_numbers import compared_as
from deploy.reports.quantities import RMS_ERROR
from deploy.reports.results import judge_rows, write_comparison_results, write_study_results
from deploy.reports.run_tables import confirmation_tables
from deploy.reports.study_tables import (
    losses_table,
    point_table,
    result_tables,
    robustness_table,
    write_study_table,
)
from deploy.reports.study_texts import sentences
from deploy.reports.tables import number
from deploy.reports.terminal import print_conditions, print_table
from deploy.reports.verdict import bounds_sentence, recording_sentences
from deploy.run.confirmation import check_confirmable
from deploy.run.console import Console
from deploy.run.exit_codes import FAULT, INTERRUPTED
from deploy.run.processes.program import require_program
from deploy.run.run_folder import ResultFolder, read_summary
from deploy.run.stop_signals import on_stop
from deploy.scenario.yaml_files import ScenarioError, find_yaml, read_yaml
from deploy.study.comparison.comparison import KIND, ComparedRuns, Comparison
from deploy.study.comparison.settling import SettlingTest
from deploy.study.folder import (
    StudyFolder,
    changes_since,
    find_folder,
    opened,
    read_study,
    require_same_provenance,
)
from deploy.study.robustness import margin_study
from deploy.study.runner import carry_out, retrace
from deploy.study.statistics import NO_EFFECT
from deploy.study.study import SHIPPED, StudyOfRuns, is_sweep
from deploy.study.sweep import load_sweep
from deploy.study.tuning.tuning import Tuning

_SHOWN_POINTS = 40
_GOES_ON = "{}: repeat the same command to continue."
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

    With --plants, each point runs with that many uncertain plants. After an interruption or a kill,
    the same command continues.
    """
    _conduct(load_sweep(options.sweep, options.definition(), options.fixed()), options)


@taking(MarginOptions)
def margin(options: MarginOptions) -> None:
    """Find the largest delay, or other quantity, at which each law keeps its bounds.

    The command brackets and bisects, with several starts and seeds. With --plants it finds the
    share of uncertain plants that keep their bounds at each of --values. After an interruption or a
    kill, the same command continues.
    """
    path, values = Path("margin"), dict[str, Any]()
    if options.study is not None:
        path = find_yaml(options.study, SHIPPED, fits=lambda file: not is_sweep(file))
        values = read_yaml(path)
    _conduct(margin_study(definition_with(options, values), path), options)


@taking(TuneOptions)
def tune(options: TuneOptions) -> None:
    """Search for the gains of laws: the same search, budget and runs for each of them.

    The gains that were found are judged with another seed, start and reference and on uncertain
    plants, and written to a scenario for each law. After an interruption or a kill, the same
    command continues; so does one with a larger --budget.
    """
    for name in ("at_least", "baseline"):
        if getattr(options, name) is not None:
            raise ScenarioError(f"--{name.replace('_', '-')}: tune has no margin to gate")
    _conduct(Tuning(options.definition(), Path("tune")), options)


@taking(CompareOptions)
def compare(options: CompareOptions) -> None:
    """Run a scenario under several laws in virtual time, and compare the results.

    After an interruption or a kill, the same command continues. With more laws, it adds them.
    """
    study = Comparison(options.definition(), Path("compare"))
    console, gate = Console(), CommandGate(options, study.definition.name, study.unit)
    with _carried_out(study, options, console) as done:
        compared = conclude_comparison(done.folder, judge_rows(study, done.folder), console)
    if done.lost is not None:
        console.print(_GOES_ON.format(done.lost), markup=False)
    ended = done.lost is None and not done.is_interrupted and compared.runs
    whole = bool(ended) and all(run.summary["completed"] for run in compared.runs)
    leave(
        interrupted=done.is_interrupted,
        whole=whole,
        kept=(all(run.kept_bounds for run in compared.runs) or not options.require_bounds)
        and (
            not whole or gate.is_passed(read_summary(done.folder.path), console, done.folder.note)
        ),
    )


class RunCounter:
    """Counts the finished runs of a study on a progress line."""

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


@dataclass
class _CarriedOut:
    """How the execution of a study ended.

    Attributes:
        folder: where its rows are.
        is_interrupted: the user has put an end to it.
        lost: why its workers are gone, if they are.
    """

    folder: StudyFolder
    is_interrupted: bool = False
    lost: Exception | None = None


def report_study(path: Path, console: Console) -> None:
    """Evaluate the rows of a study again, and write its summary and report."""
    study = read_study(path)
    with StudyFolder(path.resolve(), study).lock() as folder:
        changed = changes_since(study, folder.path)
        if not changed:
            retrace(study, folder)
            if study.kind == KIND:
                conclude_comparison(folder, judge_rows(study, folder), console)
            else:
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
    """Run or continue a study, and show its results."""
    quantity, pattern = (getattr(study.definition, key, None) for key in ("quantity", "pattern"))
    kind = compared_as(study.kind, quantity, patterns=pattern is not None)
    console, gate = Console(), CommandGate(options, study.definition.name, study.unit, kind)
    with _carried_out(study, options, console) as done:
        completed = _conclude(study, done.folder, console)
    if completed:
        has_results = any(row["error"] is None for row in done.folder.rows)
        summary = read_summary(done.folder.path)
        kept = has_results and gate.is_passed(summary, console, done.folder.note)
        leave(interrupted=False, whole=has_results, kept=kept)
    console.print(_GOES_ON.format(done.lost or "stopped"), markup=False)
    raise typer.Exit(INTERRUPTED if done.is_interrupted else FAULT)


@contextlib.contextmanager
def _carried_out(
    study: StudyOfRuns, options: WorkerOptions, console: Console
) -> Iterator[_CarriedOut]:
    """Do the runs that a study's folder lacks, and lock the folder meanwhile."""
    scheduler, out, overwrite = options.scheduler, options.out, options.overwrite
    if options.workers is not None and scheduler is not None:
        raise ScenarioError("--workers and --scheduler: a cluster has its own number of workers")
    from deploy.study.dask_workers import ClusterLostError, DaskWorkers  # heavy

    for each in study.variants:
        if scheduler is None:  # else it has to be on the hosts of the cluster
            require_program(each)
        if study.definition.confirm:
            check_confirmable(each)
    say_oddities(*study.bases)
    stop = threading.Event()
    path = None if overwrite else find_folder(study, out)
    with contextlib.ExitStack() as open_:
        if scheduler is None:  # a folder is refused before any process starts
            require_same_provenance(study, path)
            folder = open_.enter_context(opened(study, path, out, overwrite=overwrite))
        team = open_.enter_context(DaskWorkers(options.workers, scheduler, study.laws))
        if scheduler is not None:  # its hosts have other versions and files
            require_same_provenance(study, path, team.current)
            if not scheduler.startswith(_AUTHENTICATED):
                warning = _OPEN_SCHEDULER.format(scheduler)
                Console(stderr=True).print(warning, markup=False, soft_wrap=True)
            folder = open_.enter_context(opened(study, path, out, overwrite=overwrite))
        on_stop(stop.set)
        done = _CarriedOut(folder)
        with CommandProgress(console, study.definition.name, study.expected, "runs") as shown:
            try:
                carry_out(study, team, folder, stop, RunCounter(shown).done)
            except ClusterLostError as error:
                done.lost = error
        done.is_interrupted = stop.is_set() and done.lost is None
        yield done


def conclude_comparison(
    folder: ResultFolder, summary: Mapping[str, Any], console: Console
) -> ComparedRuns:
    """Write rows, summary and report of a comparison, show them, and return its runs."""
    with judging(console, folder):
        compared = write_comparison_results(folder, summary)
    if not compared.runs:
        console.print(f"results: {folder.path}", soft_wrap=True)
        return compared
    confirmed = confirmation_tables([run.summary for run in compared.runs])
    for table in (verdict_table(compared), law_table(compared, RMS_ERROR), *confirmed):
        print_table(console, table)
    sentences = [*recording_sentences(compared.runs), *map(settling_sentence, compared.settling)]
    for run in compared.runs:
        sentences += [f"{run.law}: {bounds_sentence(run)}"] if run.summary["faults"] else []
    for sentence in sentences:
        console.print(sentence, markup=False, highlight=False)
    print_conditions(console, read_summary(folder.path).get("conditions", {}))
    show_places(console, folder)
    return compared


def _conclude(study: StudyOfRuns, folder: StudyFolder, console: Console) -> bool:
    """Write table, summary and report. Returns whether the study is complete."""
    with judging(console, folder):
        summary = write_study_results(study, folder)
    _show(summary, folder, console)
    return bool(summary["completed"])


def _show(summary: dict[str, Any], folder: StudyFolder, console: Console) -> None:
    """Show the results of a study, and write its table for documents."""
    show_study(console, summary)
    if summary["kind"] not in ("sweep", "tune"):
        write_study_table(summary, folder.path / "table.md")
        console.print(f"table:   {folder.path / 'table.md'}", soft_wrap=True)
    show_places(console, folder)


def show_study(console: Console, summary: dict[str, Any]) -> None:
    """Print the result as a table."""
    if summary["kind"] in ("margin", "tune"):
        for table in result_tables(summary):
            print_table(console, table)
    elif summary["kind"] == "robustness":
        for table in (robustness_table(summary), losses_table(summary)):
            print_table(console, table)
    else:
        table = point_table(summary)
        print_table(console, replace(table, rows=table.rows[:_SHOWN_POINTS]))
        for keys in summary.get("without_effect", ()):
            said = f"warning: {keys}: {NO_EFFECT}"
            console.print(said, markup=False, soft_wrap=True)
    for sentence in sentences(summary):
        has_command = ": funnel-hil " in sentence  # to be copied whole
        console.print(sentence, markup=False, soft_wrap=has_command)
    for table in confirmation_tables([summary]):
        print_table(console, table)
    hidden = len(summary.get("points", ())) - _SHOWN_POINTS
    if hidden > 0:
        console.print(f"{hidden} more points are in the report")
    print_conditions(console, summary.get("conditions", {}))
    if summary["runs_failed"]:
        count = f"{summary['runs_failed']} of {summary['runs']}"
        failed = (f"{count} runs failed", "bold red")
        console.print(Text.assemble(failed, "; their rows say why. The commonest error:"))
        console.print(summary["commonest_error"], markup=False, soft_wrap=True)


def settling_sentence(test: SettlingTest) -> str:
    """Say in one sentence how a law settled from near and far."""
    times = [start.settling_time_s for start in test.starts]
    known = [time for time in times if time is not None]
    farthest = number(max((start.distance_rad for start in test.starts), default=None))
    bound = "" if test.bound_s is None else f", bound {number(test.bound_s)} s"
    slowest = f", at most {number(max(known))} s" if known else ""
    return (
        f"{test.law}: settled from {len(known)} of {len(times)} starts of up to {farthest} rad"
        f"{slowest}{bound}"
    )
