"""Terminal output of a run: messages of its processes, and the result."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

from rich.text import Text

from bus_schema.runtime.compiled import say_that_it_compiles
from deploy.cli.terminal.progress import CommandProgress
from deploy.judge.conditions import Conditions
from deploy.judge.link_delays import link_sentence, playout_sentence
from deploy.judge.run_data import RunData
from deploy.reports.run_tables import confirmation_tables, joint_table, timing_table
from deploy.reports.tables import number, percent, short_names
from deploy.reports.terminal import print_conditions, print_table
from deploy.reports.verdict import verdict_on_run
from deploy.run.console import Console
from deploy.run.processes.child import VIEWER
from deploy.run.processes.scheduling import missing_settings
from deploy.run.processes.status import StatusMessage

_STYLES = {"good": "bold green", "bad": "bold red", "broken": "bold red"}


def status_handler(
    progress: CommandProgress, joint_names: Sequence[str] = ()
) -> Callable[[StatusMessage], None]:
    """Return a function that shows on `progress` what the processes of a run report."""
    names = short_names(joint_names)
    state: dict[str, Any] = {}
    settings: list[dict[str, Any]] = []

    def handle(message: StatusMessage) -> None:
        if message.kind == "progress":
            if "time_s" in message.values and "time_s" not in state:
                progress.skip_to(message.values["time_s"])  # starting up is over
            state.update(message.values)
            if settings:  # of all processes, as they are at work now
                if text := missing_settings(settings):
                    progress.say(text)
                settings.clear()
            progress.update(state.get("time_s", 0.0), note=_note(state, names))
        elif message.kind == "fault":
            progress.say(f"{message.role}: {message.values['text']}")
        elif message.kind == "note" and message.role == VIEWER:
            progress.say(message.values["text"])
        elif message.kind == "compiles":
            say_that_it_compiles(progress.say)
        elif message.kind == "realtime":
            settings.extend(message.values["settings"])

    return handle


def show_summary(
    console: Console, run: RunData, summary: dict[str, Any], conditions: Conditions
) -> None:
    """Print the result of a run: two small tables, the verdict, and the conditions."""
    verdict = verdict_on_run(run, summary, conditions)
    console.print(
        f"{summary['scenario']} · {summary['law']} · {summary['clock']}", markup=False, style="bold"
    )
    if summary["ticks"]:
        print_table(console, joint_table(summary, run.setup.scenario.metrics.from_s))
        print_table(console, timing_table(summary))
        _show_link(console, summary)
    if verdict.faults:
        first, *others = verdict.faults
        console.print(Text.assemble(("fault", "bold red"), f"  {first}"), soft_wrap=True)
        if others:
            console.print(f"{len(others)} more that followed are in the report", style="dim")
    headline = verdict.headline[0].lower() + verdict.headline[1:]
    console.print(headline, style=_STYLES[verdict.level])
    for reason in verdict.reasons:
        console.print(reason, markup=False)
    factor, rate = summary["real_time_factor"], summary["timing"]["success_rate"]
    console.print(
        f"{summary['ticks']:,} ticks"
        + (f", deadlines met {percent(rate)}" if rate is not None else "")
        + (f", real-time factor {factor:.2f}" if factor is not None else "")
        + f", digest {summary['digest'][:16]}"
    )
    if skipped := summary["recording"]["ticks_skipped"]:
        sent = number(summary["transport"]["uplink"]["sent"])
        console.print(
            f"{skipped:,} {'tick' if skipped == 1 else 'ticks'} skipped because the plant was"
            f" late; states sent: {sent}"
        )
    for table in confirmation_tables([summary]):
        print_table(console, table)
    print_conditions(console, conditions)


def _show_link(console: Console, summary: dict[str, Any]) -> None:
    """What the link did in either direction, unless it did nothing; in the words of `link`."""
    for way in ("downlink", "uplink"):
        channel = summary["transport"][way]
        measured, emulated = channel["measured_ms"], channel["delay_ms"]
        delays_ms = emulated if measured["max"] is None else measured
        if channel["sent"] and (channel["lost"] or delays_ms["max"]):
            said = link_sentence(
                channel["sent"], summary["duration_s"], channel["lost"],
                (channel["loss_burst"] or {}).get("longest"), delays_ms, channel["reordered"],
            )  # fmt: skip
            console.print(f"{way}: {said}", highlight=False, soft_wrap=True)
    playout = summary["transport"].get("playout")
    if playout and playout["late"] is not None and playout["arrival_ms"]["max"] is not None:
        console.print(playout_sentence(playout), highlight=False, soft_wrap=True)


def show_relay(console: Console, held_back: dict[str, Any]) -> None:
    """Print the lateness of the real delay's relay, from the manifest."""
    late = held_back.get("lateness_us")
    if late is None:
        return  # the relay ended before it could report
    shown = ", ".join(f"{name} {number(late[name])}" for name in ("p50", "p99", "max"))
    console.print(
        f"real delay {held_back['round_trip_ms']:g} ms: {held_back['chunks']} chunks of bytes left"
        f" the relay later than due by {shown} µs",
        highlight=False,
    )


def _note(state: dict[str, Any], names: Sequence[str]) -> str:
    """Return a short note: the joint nearest to its bound, and deadlines missed."""
    parts = []
    if "error_mrad" in state:
        number = state["joint"]
        joint = names[number - 1] if number <= len(names) else f"joint {number}"
        parts.append(f"{joint} {state['error_mrad']:+.3f} of {state['bound_mrad']:.1f} mrad")
    if "deadline_misses" in state:
        parts.append(f"deadline misses {state['deadline_misses']}")
    return ", ".join(parts)
