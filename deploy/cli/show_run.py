"""Terminal output of a run in progress: messages of its processes."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

from bus_schema.runtime.compiled import say_that_it_compiles
from deploy.cli.parts.progress import CommandProgress
from deploy.reports.tables import number, short_names
from deploy.run.console import Console
from deploy.run.processes.child import VIEWER
from deploy.run.processes.scheduling import missing_settings
from deploy.run.processes.status import StatusMessage


def status_handler(
    progress: CommandProgress, joint_names: Sequence[str] = ()
) -> Callable[[StatusMessage], None]:
    """Return a function that shows on `progress` what the processes of a run report."""
    names = short_names(joint_names)
    state: dict[str, Any] = {}
    settings: list[dict[str, Any]] = []
    warnings: set[str] = set()

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
        elif message.kind == "warning":
            if (text := message.values["text"]) not in warnings:  # both loops may have it
                warnings.add(text)
                progress.say(f"{message.role}: {text}")
        elif message.kind == "compiles":
            say_that_it_compiles(progress.say)
        elif message.kind == "realtime":
            settings.extend(message.values["settings"])

    return handle


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
    if "late_ticks" in state:
        parts.append(f"deadlines missed {state['late_ticks']}")
    return ", ".join(parts)
