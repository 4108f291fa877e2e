"""How a command that leaves a run folder ends: the run judged, shown, and an exit code."""

from __future__ import annotations

from typing import Any

import typer
from rich.console import Console
from rich.markup import escape

from deploy.cli.common import BOUNDS_NOT_KEPT, FAULT, FINISHED, INTERRUPTED
from deploy.cli.show_run import show_summary
from deploy.processes.launcher import RunOutcome
from deploy.runs.run_folder import RunFolder, RunFolderError, load_run


def finish(
    console: Console, folder: RunFolder, outcome: RunOutcome, *, require_bounds: bool
) -> None:
    """Judge a run, show the result, and leave with the exit code it deserves."""
    try:
        data, _ = load_run(folder.path)
    except RunFolderError as error:
        faults = [] if outcome.interrupted else [*outcome.failures, str(error)]
        for fault in faults or ["stopped before the run began"]:
            console.print(escape(fault))
        folder.write_summary({"completed": False, "faults": faults})
        raise typer.Exit(INTERRUPTED if outcome.interrupted else FAULT) from error
    summary = folder.conclude(data, outcome.failures)
    show_summary(console, data, summary)
    console.print(f"results: {folder.path}", soft_wrap=True)
    console.print(f"report:  {folder.report}", soft_wrap=True)
    raise typer.Exit(_exit_code(summary, outcome, require_bounds=require_bounds))


def _exit_code(summary: dict[str, Any], outcome: RunOutcome, *, require_bounds: bool) -> int:
    if outcome.interrupted:
        return INTERRUPTED
    if summary["faults"] or not summary["completed"]:
        return FAULT
    if require_bounds and not summary["bounds"]["kept"]:
        return BOUNDS_NOT_KEPT
    return FINISHED
