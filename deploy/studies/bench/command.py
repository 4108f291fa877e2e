"""`bench`: costs of a loop, a simulation and a sweep on this machine, as a table and as JSON.

It makes no absolute claim: times depend on the machine and its load. All candidates of a section
are measured in turn, so that the load affects them equally.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console

from bus_schema.errors import InputError
from bus_schema.recording.atomic_files import write_json
from deploy.reports.tables import Column, Table, number
from deploy.reports.terminal import print_table
from deploy.run.exit_codes import FAULT, FINISHED
from deploy.run.run_folder import provenance
from deploy.scenario.yaml_files import ScenarioError
from deploy.studies.bench.first_runs import measure_first_runs
from deploy.studies.bench.loop import (
    measure_control_steps,
    measure_loop_costs,
    measure_real_time,
    measure_sweep,
)
from deploy.studies.bench.measure import Costs, Section

FAILED = "could not be measured:"
_SCENARIO = "paper_arm"


def bench(
    json_file: Annotated[
        Path | None, typer.Option("--json", metavar="FILE", help="Write the numbers to a file.")
    ] = None,
    quick: Annotated[
        bool, typer.Option("--quick", help="Fewer and shorter repetitions: a first impression.")
    ] = False,
) -> None:
    """Measure what things cost on this machine, as ratios of medians side by side."""
    sections = run_bench(Console(), json_file, quick=quick)
    raise typer.Exit(FINISHED if all(section.ratios for section in sections) else FAULT)


def run_bench(console: Console, json_file: Path | None, *, quick: bool) -> list[Section]:
    """Measure everything, show the results, and write them to a file.

    Args:
        console: where to show the results.
        json_file: file to write; None for none.
        quick: fewer and shorter repetitions.

    Raises:
        ScenarioError: the file cannot be written.
    """
    if json_file is not None:
        _require_writable(json_file)
    sections = []
    for title, measure in _plan(quick=quick).items():
        with console.status(f"measuring: {title}"):
            sections.append(_measured(title, measure))
        show_section(console, sections[-1])
    if json_file is not None:
        write_json(json_file, as_dict(sections, quick=quick))
        console.print(f"numbers: {json_file}", soft_wrap=True)
    return sections


def as_dict(sections: list[Section], *, quick: bool) -> dict[str, object]:
    """Return all numbers, for JSON."""
    return {
        "host": provenance()["host"],
        "quick": quick,
        "sections": {section.title: section.as_dict() for section in sections},
    }


def show_section(console: Console, section: Section) -> None:
    """Show one section as a table, a row per ratio."""
    headings = ("median", "lowest", "highest", "µs", "over µs")
    rows = [
        [
            ratio.name,
            *(f"{getattr(ratio.value, name):.2f}" for name in ("median", "lowest", "highest")),
            _sum(section.costs_us, ratio.over), _sum(section.costs_us, ratio.under),
        ]
        for ratio in section.ratios
    ]  # fmt: skip
    if rows:
        columns = [Column("ratio", is_text=True), *map(Column, headings)]
        print_table(console, Table(section.title, columns, rows))
    else:
        console.print(section.title)
    for note in section.notes:
        console.print(note, markup=False, highlight=False)
    console.print()


def _measured(title: str, measure: Callable[[], Section]) -> Section:
    """Return a section, or one without numbers that explains why it has none."""
    try:
        return measure()
    except (RuntimeError, OSError, InputError) as error:
        return Section(title.capitalize(), {}, [], [f"{FAILED} {error}"])


def _plan(*, quick: bool) -> dict[str, Callable[[], Section]]:
    repetitions, seconds = (2, 0.5) if quick else (4, 1.5)
    return {
        "control step": lambda: measure_control_steps(round(2000 * seconds), repetitions),
        "ticks": lambda: measure_loop_costs(_SCENARIO, seconds, repetitions),
        "real time": lambda: measure_real_time(_SCENARIO, seconds, repetitions),
        "first runs": lambda: measure_first_runs(_SCENARIO),
        "sweep": lambda: measure_sweep(_SCENARIO, *(2.0, 20, 1) if quick else (6.0, 30, 1)),
    }


def _require_writable(file: Path) -> None:
    """Check before minutes of measuring, not after."""
    try:
        file.parent.mkdir(parents=True, exist_ok=True)
        file.touch()
    except OSError as error:
        raise ScenarioError(f"--json {file}: cannot be written: {error.strerror}") from error


def _sum(costs: Costs, names: tuple[str, ...]) -> str:
    return number(sum(costs[name].median for name in names))
