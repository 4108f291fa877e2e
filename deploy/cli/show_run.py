"""What people see in the terminal: progress while a run lasts, and its result as a table."""

from __future__ import annotations

import time
from typing import Any

from rich.console import Console
from rich.markup import escape
from rich.progress import BarColumn, Progress, TaskID, TextColumn, TimeRemainingColumn
from rich.table import Table

from deploy.processes.status import StatusMessage
from deploy.reports.verdict import PARTIAL

_PLAIN_LINE_S = 2.0


class RunProgress:
    """Progress of a run: a live line on a terminal, a plain line every other second elsewhere."""

    def __init__(self, console: Console, name: str, duration_s: float) -> None:
        self._console = console
        self._duration_s = duration_s
        self._last_line_s = time.monotonic()
        self._state: dict[str, Any] = {}
        self._bar = Progress(
            TextColumn("[bold]{task.description}"),
            BarColumn(),
            TextColumn("{task.completed:6.2f} / {task.total:g} s"),
            TextColumn("{task.fields[state]}"),
            TimeRemainingColumn(compact=True),
            console=console,
            transient=True,
            disable=not console.is_terminal,
        )
        self._task: TaskID = self._bar.add_task(name, total=duration_s, state="starting")

    def __enter__(self) -> RunProgress:
        self._bar.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._bar.stop()

    def hear(self, message: StatusMessage) -> None:
        """Take in what a child process reported."""
        if message.kind == "progress":
            self._state |= message.values
            self._show()
        elif message.kind == "fault":
            self._console.print(f"{message.role}: {message.values['text']}", markup=False)
        elif message.kind == "lacks":
            self._console.print(f"{message.role} {message.values['text']}", markup=False)

    def at(self, time_s: float) -> None:
        """The run has come to this time."""
        self._state["time_s"] = time_s
        self._show()

    def _show(self) -> None:
        time_s = self._state.get("time_s", 0.0)
        parts = []
        if "error_mrad" in self._state:
            parts.append(
                "joint {joint}: error {error_mrad:+.3f} of {bound_mrad:.1f} mrad".format(
                    **self._state
                )
            )
        if "deadline_misses" in self._state:
            parts.append(f"deadline misses {self._state['deadline_misses']}")
        state = ", ".join(parts)
        if self._console.is_terminal:
            self._bar.update(self._task, completed=time_s, state=state)
        elif time.monotonic() - self._last_line_s >= _PLAIN_LINE_S:
            self._last_line_s = time.monotonic()
            self._console.print(f"{time_s:.2f} of {self._duration_s:g} s  {state}", markup=False)


def show_summary(console: Console, summary: dict[str, Any]) -> None:
    """The result of a run as two small tables and a verdict."""
    tracking, torque = summary["tracking"], summary["torque"]
    joints = Table(title=f"{summary['scenario']} · {summary['law']} · {summary['clock']}")
    joints.add_column("joint")
    for heading in ("RMS mrad", "max mrad", "settled s", "torque RMS N m", "Σ|Δτ| N m/s"):
        joints.add_column(heading, justify="right")
    for index, name in enumerate(tracking["joint_names"]):
        joints.add_row(
            name,
            _number(tracking["rms_rad"], index, 1e3, 4),
            _number(tracking["max_abs_rad"], index, 1e3, 3),
            _number(tracking["settling_time_s"], index, 1.0, 3),
            _number(torque["rms_nm"], index, 1.0, 1),
            _number(torque["total_variation_nm_per_s"], index, 1.0, 0),
        )
    console.print(joints)
    console.print(_timing_table(summary))
    _show_verdict(console, summary)


def _timing_table(summary: dict[str, Any]) -> Table:
    timing = summary["timing"]
    table = Table(title="timing, µs")
    table.add_column("quantity")
    for heading in ("p50", "p99", "p99.9", "max"):
        table.add_column(heading, justify="right")
    for name in (
        "round_trip_us", "command_age_us", "state_age_us", "control_step_us", "wakeup_lateness_us"
    ):  # fmt: skip
        values = timing[name].values()
        shown = ["–" if value is None else f"{value:.0f}" for value in values]
        table.add_row(name.removesuffix("_us").replace("_", " "), *shown)
    return table


def _show_verdict(console: Console, summary: dict[str, Any]) -> None:
    bounds, timing = summary["bounds"], summary["timing"]
    if summary["faults"]:
        first, *others = summary["faults"]
        console.print(f"[bold red]fault[/]  {escape(first)}")
        if others:
            console.print(f"[dim]{len(others)} more that followed are in the report[/]")
    if bounds["kept"]:
        colour, when = ("green", "") if summary["completed"] else ("yellow", " as far as it went")
        margin = f"smallest margin {bounds['margin_min']:.1%}"
        console.print(f"[bold {colour}]bounds kept{when}[/]  {margin}")
    elif bounds["violation_fraction"] is None:
        console.print("[bold red]nothing to judge[/]  no tick was recorded")
    else:
        console.print(
            f"[bold red]bounds not kept[/]  outside for {bounds['violation_fraction']:.1%} of the"
            f" time, first at {bounds['first_violation_s']:.3f} s"
        )
    recorder = summary["recorder"]
    if not recorder["complete"]:
        console.print(f"[bold yellow]partial[/]  {PARTIAL}")
    if recorder["lost"]:
        console.print(f"[bold yellow]lost[/]  {recorder['lost']} messages, not recorded")
    if timing["deadline_misses"] and timing["stolen_ms"]:
        console.print(
            f"[bold yellow]stolen[/]  a hypervisor took {timing['stolen_ms']:.0f} ms of CPU time"
            " away during the run"
        )
    rate, factor = timing["success_rate"], summary["real_time_factor"]
    console.print(
        f"{summary['ticks']} ticks"
        + (f", {rate:.3%} of the deadlines met" if rate is not None else "")
        + (f", real-time factor {factor:.2f}" if factor is not None else "")
        + f", digest {summary['digest'][:16]}"
    )


def _number(values: list[float | None] | None, index: int, scale: float, digits: int) -> str:
    value = None if values is None else values[index]
    return "–" if value is None else f"{value * scale:.{digits}f}"
