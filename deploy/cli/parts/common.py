"""Functions that commands share: parsing laws, handling interrupts, finishing a run."""

from __future__ import annotations

import contextlib
import signal
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any, NoReturn

import typer

from bus_schema.configuration import shown
from bus_schema.errors import Stopped
from bus_schema.foreign_text import say
from bus_schema.recording.atomic_files import write_json
from controller.law_choice import PROCESS, is_law_name
from controller.laws import LAWS, likely_law
from controller.laws.custom import EXTERNAL, is_custom
from deploy.cli.parts.options import GateOptions, OneRunOptions
from deploy.cli.parts.progress import CommandProgress
from deploy.cli.parts.watched import Watched
from deploy.judge import gate as gating
from deploy.judge.tested_with import Tested, require_same_test
from deploy.judge.verdict import decide
from deploy.reports.gate_files import write_history, write_junit, write_markdown
from deploy.reports.kinds import gauged, kind_named, numbers_in, read_baseline, require_numbers
from deploy.reports.results import TABLE_FILE, Results, write_run
from deploy.reports.terminal import print_page
from deploy.run.confirmation import confirmation_of
from deploy.run.console import Console
from deploy.run.execute import JudgedRun
from deploy.run.exit_codes import BAD_INPUT, BOUNDS_NOT_KEPT, FAULT, FINISHED, INTERRUPTED
from deploy.run.processes.child import RunOutcome
from deploy.run.run_folder import ResultFolder, RunFolder, RunFolderError
from deploy.run.stop_signals import (
    STOPS,
    WITHIN_S,
    end_if_asked,
    on_stop,
    stop_at_once,
    stop_between_steps,
)
from deploy.scenario.checking.warnings import all_warnings
from deploy.scenario.setup import Setup
from deploy.scenario.yaml_files import ScenarioError
from plant_emulator.plant_loop import PlantLoop


def parse_laws(text: str | None, option: str = "--laws") -> list[str] | None:
    """Return the names of laws in ``a,b,…``, the value of an option, or None for all laws.

    Raises:
        ScenarioError: the text has no name, or an unknown one.
    """
    if text is None:
        return None
    named = list(dict.fromkeys(name.strip() for name in text.split(",") if name.strip()))
    if not named:
        raise ScenarioError(f"{option} {text!r}: must name one or more of {', '.join(LAWS)}")
    for law in named:
        if not is_law_name(law):
            allowed = (
                f"{', '.join(LAWS)}, {PROCESS}, module:Class for your own law, {EXTERNAL}, or a"
                " policy server as lerobot://host:port or openpi://host:port"
            )
            raise ScenarioError(f"{option} {shown(law)}: must be one of {allowed}{likely_law(law)}")
    return named


def say_warnings(*setups: Setup, more: Sequence[str] = ()) -> None:
    """Print each warning about the scenarios and arms once, and `more`, to standard error."""
    for each in (*all_warnings(setups), *more):
        say(f"warning: {each}", err=True)


def watching(
    progress: CommandProgress, setup: Setup, name: str, stop: threading.Event
) -> Callable[[PlantLoop], None]:
    """Return a function that `simulate` calls at the start: it shows progress and handles stops.

    If a law does not return, the process ends after `WITHIN_S`, unless `on_stop` was called again.

    Args:
        progress: where to show the progress.
        setup: the scenario.
        name: name of the run on the progress line.
        stop: set by an interrupt.
    """

    def watch(loop: PlantLoop) -> None:
        progress.follow(lambda: setup.grid.tick_ns(loop.tick) * 1e-9, name)

        def request_stop() -> None:
            stop.set()
            loop.request_stop()

        on_stop(request_stop, WITHIN_S, may_hold_lock=is_custom(setup.scenario.controller.law))

    return watch


class ResultGate:
    """The gate of a command, checked before anything starts.

    Args:
        options: what it must reach.
        name: of what is gated.
        unit: of its numbers.
        tested: the test behind them.
        kind: kind of the result.
        quantity: quantity of its margins, if it has any.
        patterns: whether they are for every pattern of delays.
        furthest: the last value that is tried; None where there is none.

    Raises:
        ScenarioError: the options cannot be used with this result.
    """

    def __init__(
        self, options: GateOptions, name: str, unit: str, tested: Tested, kind: str = "run",
        quantity: str | None = None, *, patterns: bool = False,
        furthest: gating.Gauged | None = None,
    ) -> None:  # fmt: skip
        result = kind_named(kind)
        gating.require_units(options.at_least, options.tolerance, result.units(unit))
        unit = result.unit_for(gating.unit_of(options.at_least, options.tolerance), unit)
        before = None if options.baseline is None else read_baseline(options.baseline, unit)
        if options.allow_changes and before is None:
            raise ScenarioError("--allow-changes: needs --baseline")
        numbers = None if before is None else (before.compared_as, numbers_in(before, unit))
        self._gate = gating.build_gate(options.at_least, options.tolerance, numbers)
        compared = result.compared_with(quantity, patterns=patterns)
        gating.require_fit(self._gate, unit, compared)
        gating.require_reach(self._gate, furthest)
        if options.baseline is not None and before is not None:
            require_numbers(options.baseline, before, unit)
        self._changes: list[str] = []
        if before is not None:
            allows_changes = options.allow_changes
            self._changes = require_same_test(
                before.tested_with, tested, allows_changes=allows_changes
            )
        self._options, self._name, self._unit = options, name, unit
        if options.history is not None:
            gating.read_history(options.history)

    def is_passed(self, summary: Mapping[str, Any], console: Console, note: str = "") -> bool:
        """Whether a result reaches what it must; writes the files, and prints what failed.

        Args:
            summary: the result.
            console: where to print.
            note: what else to say about the result.
        """
        options, found = self._options, gauged(summary, self._unit)
        failures = self._gate.failures(found)
        changes = [f"--baseline: {each}" for each in self._changes]
        note = "; ".join(filter(None, [note, *changes]))
        if options.history is not None:
            with gating.locked_history(options.history) as entries:
                failures |= {
                    each.name: failures[each.name] + gating.since_when(entries, each)
                    for each in found
                    if each.name in failures
                }
                entries.append(gating.entry_of(found))
                write_history(options.history, self._name, entries, self._unit)
        if options.junit is not None:
            write_junit(options.junit, found, failures, note)
        if options.markdown is not None:
            write_markdown(options.markdown, found, failures)
        for sentence in failures.values():
            console.print(f"gate: {sentence}", style="bold red", markup=False, soft_wrap=True)
        if self._gate.is_given and (note or not failures):
            numbers = "" if failures else "with " + ", ".join(each.text for each in found)
            verdict = "failed" if failures else "passed"
            text = "; ".join(filter(None, [verdict, note, numbers]))
            console.print(f"gate: {text}", markup=False, soft_wrap=True)
        return not failures


def leave(*, interrupted: bool, whole: bool, kept: bool, fault: int = FAULT) -> NoReturn:
    """End a command with its exit code.

    Args:
        interrupted: the user stopped the command.
        whole: all runs finished without a fault.
        kept: all runs kept their bounds, or nothing requires it.
        fault: exit code for runs with a fault.
    """
    if interrupted:
        raise typer.Exit(INTERRUPTED)
    if not whole:
        raise typer.Exit(fault)
    raise typer.Exit(FINISHED if kept else BOUNDS_NOT_KEPT)


def show_results(console: Console, folder: ResultFolder, judge: Callable[[], Results]) -> Results:
    """Judge results, which writes their files, and show them.

    Args:
        console: where to show them.
        folder: their folder.
        judge: writes the results, and returns them.
    """
    with judging(console, folder):
        results = judge()
    if results.page is not None:
        print_page(console, results.page)
    if (table := folder.path / TABLE_FILE).exists():
        console.print(f"table:   {table}", soft_wrap=True)
    console.print(f"results: {folder.path}", soft_wrap=True)
    if folder.report.exists():
        console.print(f"report:  {folder.report}", soft_wrap=True)
    else:
        console.print(f"funnel-hil report {folder.path} writes the report", soft_wrap=True)
    return results


@contextlib.contextmanager
def judging(console: Console, folder: ResultFolder) -> Iterator[None]:
    """Let a request to stop end the evaluation after its current step.

    Files written by then stay. `funnel-hil report` repeats the evaluation.
    """
    before = {number: signal.getsignal(number) for number in STOPS}
    stop_between_steps()
    try:
        yield
        end_if_asked()
    except Stopped:
        console.print(
            f"stopped during the evaluation: funnel-hil report {folder.path} repeats it",
            soft_wrap=True,
        )
        raise typer.Exit(INTERRUPTED) from None
    finally:
        stop_at_once()  # no deadline of what is over ends what follows
        for number, handler in before.items():
            signal.signal(number, handler)


def finish(
    console: Console,
    folder: RunFolder,
    run: JudgedRun,
    options: OneRunOptions,
    *,
    confirms: bool = False,
    gate: ResultGate | None = None,
) -> None:
    """Evaluate a run, show the result, and end with its exit code.

    Args:
        console: where to show it.
        folder: folder of the run.
        run: the finished run.
        options: `no_report` and `require_bounds` count.
        confirms: whether to repeat the run on other physics.
        gate: thresholds that the run must reach, if any.
    """

    def judge() -> Results:
        _require_data(console, folder, run)
        if confirms:
            run.result = run.result.replaced(confirmation=confirmation_of(run, Watched()))
        return write_run(folder, run, draws_report=not options.no_report)

    summary = show_results(console, folder, judge).summary
    is_passed = gate is None or not summary["completed"] or gate.is_passed(summary, console)
    leave(
        interrupted=run.outcome.interrupted,
        whole=summary["completed"],
        kept=(summary["bounds"]["kept"] or not options.require_bounds) and is_passed,
        fault=_fault_code(run.outcome),
    )


def _require_data(console: Console, folder: RunFolder, run: JudgedRun) -> None:
    """Read the data of a run. Ends the command if nothing was recorded."""
    try:
        _ = run.data
    except RunFolderError as error:
        outcome = run.outcome
        faults = [] if outcome.interrupted else [*outcome.failures, str(error)]
        for fault in faults or ["stopped before the run began"]:
            console.print(fault)
        found = {"completed": False, "faults": faults, "verdict": decide(faults).value}
        write_json(folder.summary, found)
        raise typer.Exit(INTERRUPTED if outcome.interrupted else _fault_code(outcome)) from error


def _fault_code(outcome: RunOutcome) -> int:
    """Return the exit code of a run with a fault, which is that of the process that failed."""
    return BAD_INPUT if outcome.is_bad_input else FAULT
