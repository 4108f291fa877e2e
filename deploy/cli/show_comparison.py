"""What people see of a comparison in the terminal: progress over the laws, and the result."""

from __future__ import annotations

import threading
from collections.abc import Sequence

from rich import box
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn
from rich.table import Table

from deploy.comparison.comparison import Comparison, LawRun
from deploy.comparison.settling import SettlingTest
from deploy.reports.compare_tables import bounds_sentence, largest
from deploy.reports.tables import number, of_joint
from deploy.scenario.scenario import Setup
from plant_emulator.plant_loop import PlantLoop

_POLL_S = 0.1


class CompareProgress:
    """Progress over all laws: a live line on a terminal, a plain line per law elsewhere."""

    def __init__(self, console: Console, setups: Sequence[Setup]) -> None:
        self._console = console
        self._loop: PlantLoop | None = None
        self._ticks_before = 0
        self._setups = {setup.scenario.controller.law: setup for setup in setups}
        self._over = threading.Event()
        self._bar = Progress(
            TextColumn("[bold]{task.description}"),
            BarColumn(),
            TextColumn("law {task.fields[number]} of {task.fields[laws]}"),
            TimeRemainingColumn(compact=True),
            console=console,
            transient=True,
            disable=not console.is_terminal,
        )
        total = sum(setup.ticks for setup in setups)
        self._task = self._bar.add_task("starting", total=total, number=0, laws=len(setups))
        self._finished = 0

    def __enter__(self) -> CompareProgress:
        self._bar.start()
        self._watcher = threading.Thread(target=self._watch, daemon=True)
        self._watcher.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._over.set()
        self._watcher.join()
        self._bar.stop()

    def start(self, law: str, loop: PlantLoop) -> None:
        """A law begins; `loop` tells how far it is."""
        self._loop = loop
        self._bar.update(self._task, description=law, number=self._finished + 1)

    def done(self, run: LawRun) -> None:
        """A law has come to its end."""
        self._loop = None
        self._finished += 1
        self._ticks_before += self._setups[run.law].ticks
        self._bar.update(self._task, completed=self._ticks_before)
        self._console.print(f"{run.law}: {bounds_sentence(run)}", markup=False, highlight=False)

    def _watch(self) -> None:
        while not self._over.wait(_POLL_S):
            loop = self._loop
            if loop is not None:
                self._bar.update(self._task, completed=self._ticks_before + loop.tick)


def settling_sentence(test: SettlingTest) -> str:
    """How a law settled from near and far."""
    times = [row.settling_time_s for row in test.rows]
    known = [time for time in times if time is not None]
    farthest = number(max((row.distance_rad for row in test.rows), default=None))
    bound = "" if test.bound_s is None else f", bound {number(test.bound_s)} s"
    slowest = f", at most {number(max(known))} s" if known else ""
    return (
        f"{test.law}: settled from {len(known)} of {len(times)} starts of up to {farthest} rad"
        f"{slowest}{bound}"
    )


def show_comparison(console: Console, comparison: Comparison) -> None:
    """The result as two tables: what decides, and the RMS errors joint by joint."""
    if not comparison.runs:
        console.print("no law was run")
        return
    console.print(_verdict_table(comparison))
    console.print(_rms_table(comparison))


def _verdict_table(comparison: Comparison) -> Table:
    scenario = comparison.runs[0].data.setup.scenario
    title = f"{scenario.name} · {scenario.duration_s:g} s · worst joint of each law"
    table = _table(title)
    for heading in (
        "bounds", "outside\n%", "margin\n%", "Σ|Δτ|\nN m/s", "> 50 Hz\n%", "settled\ns", "bound\ns"
    ):  # fmt: skip
        table.add_column(heading, justify="right", no_wrap=True)
    for run in comparison.runs:
        tracking, torque, bounds = (run.summary[s] for s in ("tracking", "torque", "bounds"))
        joints = range(len(tracking["joint_names"]))
        settling_bounds = [of_joint(tracking["settling_bound_s"], joint) for joint in joints]
        table.add_row(
            run.law, _status(run), number(bounds["violation_fraction"], 100.0),
            number(bounds["margin_min"], 100.0),
            number(largest(torque["total_variation_nm_per_s"])),
            _fixed(largest(torque["share_above_50_hz"])),
            number(largest(tracking["settling_time_s"])), number(largest(settling_bounds)),
        )  # fmt: skip
    return table


def _rms_table(comparison: Comparison) -> Table:
    tracking = comparison.runs[0].summary["tracking"]
    from_s = comparison.runs[0].data.setup.scenario.metrics.from_s
    table = _table(f"RMS error from {from_s:g} s on, mrad")
    for name in tracking["joint_names"]:
        table.add_column(name, justify="right", overflow="fold")
    for run in comparison.runs:
        values = [
            of_joint(run.summary["tracking"]["rms_rad"], joint)
            for joint in range(len(tracking["joint_names"]))
        ]
        table.add_row(run.law, *(number(value, 1e3) for value in values))
    return table


def _table(title: str) -> Table:
    table = Table(title=title, title_justify="left", box=box.SIMPLE_HEAD, padding=0)
    table.add_column("law", no_wrap=True)
    return table


def _fixed(share: float | None) -> str:
    return "–" if share is None else f"{100.0 * share:.3f}"


def _status(run: LawRun) -> str:
    if not run.is_whole:
        return "[bold red]fault[/]"
    return "[bold green]kept[/]" if run.kept_bounds else "[bold red]lost[/]"
