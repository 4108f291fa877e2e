"""The commands that do many runs: sweeps and margins."""

from __future__ import annotations

import threading
from pathlib import Path
from typing import Annotated, Any

import typer
import yaml
from rich.console import Console

from deploy.cli.common import FAULT, FINISHED, INTERRUPTED, Out, Overrides, on_interrupt
from deploy.cli.progress import CommandProgress
from deploy.cli.show_study import RunCounter, show_study
from deploy.comparison.compare import parse_laws
from deploy.reports.study_report import write_study_report
from deploy.reports.study_tables import write_margin_table
from deploy.scenario.yaml_files import ScenarioError, parse_override, read_yaml
from deploy.study import margin as margins
from deploy.study import sweep as sweeps
from deploy.study.margin import Margin, MarginDefinition
from deploy.study.study import carry_out, retrace
from deploy.study.study_definition import find_study, validated
from deploy.study.study_folder import (
    StudyFolder,
    create_folder,
    find_folder,
    read_study,
    study_text,
)
from deploy.study.sweep import Sweep, load_sweep

Study = Sweep | Margin

WorkerCount = Annotated[
    int | None,
    typer.Option("--workers", min=1, help="Processes to run on; one per core by default."),
]
Scheduler = Annotated[
    str | None,
    typer.Option("--scheduler", metavar="ADDRESS", help="A Dask scheduler: tcp://host:8786."),
]


def sweep(
    definition: Annotated[
        str, typer.Argument(metavar="SWEEP", help="A sweep file, or the name of a shipped one.")
    ],
    workers: WorkerCount = None,
    scheduler: Scheduler = None,
    out: Out = None,
) -> None:
    """Run every point of a grid with every seed, on all cores or a Dask cluster.

    Interrupted or killed, the same command goes on where it stopped.
    """
    _conduct(load_sweep(definition), workers, scheduler, out)


def margin(
    scenario: Annotated[
        list[str] | None,
        typer.Argument(help="Scenario files or names of shipped ones; default paper_arm."),
    ] = None,
    laws: Annotated[
        str | None, typer.Option("--laws", metavar="A,B,…", help="Laws; all by default.")
    ] = None,
    compensation: Annotated[
        str | None,
        typer.Option("--compensation", metavar="off,on", help="Delay compensation off, on, both."),
    ] = None,
    quantity: Annotated[
        str | None, typer.Option("--quantity", help="delay (round trip), jitter or loss.")
    ] = None,
    seeds: Annotated[
        str | None, typer.Option("--seeds", metavar="N", help="How many, or a list [3, 5].")
    ] = None,
    offsets: Annotated[
        str | None,
        typer.Option("--offsets", metavar="A,B,…", help="Factors on the initial offset."),
    ] = None,
    duration: Annotated[
        float | None, typer.Option("--duration", help="Length of each run, s; default 8.")
    ] = None,
    resolution: Annotated[
        float | None, typer.Option("--resolution", help="To which the margin is found: ms or loss.")
    ] = None,
    limit: Annotated[
        float | None, typer.Option("--limit", help="The largest value tried: ms or loss.")
    ] = None,
    study: Annotated[
        str | None,
        typer.Option("--study", help="A file with all of this, or the name of a shipped one."),
    ] = None,
    overrides: Overrides = None,
    workers: WorkerCount = None,
    scheduler: Scheduler = None,
    out: Out = None,
) -> None:
    """Find the largest delay, jitter or loss at which each law keeps its bounds.

    Bracketing and bisection, from several starts with several seeds. Interrupted or killed, the
    same command goes on where it stopped.
    """
    given: dict[str, Any] = {
        "scenarios": scenario or None,
        "laws": None if laws is None else parse_laws(laws),
        "compensation": _listed(compensation),
        "quantity": quantity,
        "seeds": None if seeds is None else yaml.safe_load(seeds),
        "offsets": _listed(offsets),
        "duration_s": duration,
        "resolution": resolution,
        "limit": limit,
    }
    given = {key: value for key, value in given.items() if value is not None}
    path = Path("margin") if study is None else find_study(study)
    values = {} if study is None else read_yaml(path)
    fixed = dict(map(parse_override, overrides or []))
    if fixed:
        values["set"] = {**(values.get("set") or {}), **fixed}
    definition = validated({**values, **given}, MarginDefinition, path)
    folder = Path() if study is None else path.parent
    _conduct(Margin(definition, folder, str(path)), workers, scheduler, out)


def is_study(path: Path) -> bool:
    """Whether a folder holds a sweep or margins."""
    return (path / "study.yaml").is_file()


def report_study(path: Path, console: Console) -> None:
    """Judge the rows of a study again, and write its summary and report."""
    values = read_study(path)
    study: Study
    if values["kind"] == sweeps.KIND:
        study = sweeps.restore(values["definition"], path)
    else:
        study = margins.restore(values["definition"], path)
    folder = StudyFolder(path.resolve(), study.kind, study.columns, study.seeds[0])
    folder.lock()
    retrace(study, folder)
    _conclude(study, folder, console)


def _conduct(study: Study, workers: int | None, scheduler: str | None, out: Path | None) -> None:
    """Carry a study out, or on, and show what came of it."""
    if workers is not None and scheduler is not None:
        raise ScenarioError("--workers and --scheduler: a cluster has its own number of workers")
    from deploy.study.dask_workers import ClusterLostError, DaskWorkers  # heavy

    stop, console = threading.Event(), Console()
    text = study_text(study.kind, study.definition_values(), study.bases)
    path = find_folder(study.kind, study.name, out, text)
    with DaskWorkers(workers, scheduler) as team:
        path = path or create_folder(study.kind, study.name, out, text)
        folder = StudyFolder(path, study.kind, study.columns, study.seeds[0])
        folder.lock()
        on_interrupt(stop.set)
        lost = None
        with CommandProgress(console, study.name, study.expected, "runs") as progress:
            try:
                carry_out(study, team, folder, RunCounter(progress), stop)
            except ClusterLostError as error:
                lost = error
            finally:
                folder.flush()
    complete = _conclude(study, folder, console)
    if not complete:
        reason = f"{lost}; the" if lost else "The"
        console.print(f"{reason} same command goes on from here.", markup=False)
    code = FINISHED if complete else INTERRUPTED if lost is None else FAULT
    raise typer.Exit(code)


def _conclude(study: Study, folder: StudyFolder, console: Console) -> bool:
    """Write table, summary and report; whether the study is complete."""
    folder.put_together()
    summary = study.summary(folder.rows)
    folder.write_summary(summary)
    write_study_report(summary, folder)
    show_study(console, summary)
    if study.kind == margins.KIND:
        write_margin_table(summary, folder.path / "table.md")
        console.print(f"table:   {folder.path / 'table.md'}", soft_wrap=True)
    console.print(f"results: {folder.path}", soft_wrap=True)
    console.print(f"report:  {folder.report}", soft_wrap=True)
    return bool(summary["completed"])


def _listed(text: str | None) -> list[Any] | None:
    """Values from ``a,b,…``, typed as YAML has them."""
    return None if text is None else [yaml.safe_load(part) for part in text.split(",")]
