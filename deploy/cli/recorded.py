"""Commands for recorded results: `report` and `replay`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer
from rich.text import Text

from controller.laws.custom import is_custom
from deploy.cli.parts.common import show_results
from deploy.judge.arithmetic import difference_of_arithmetic
from deploy.judge.bounds import all_damage
from deploy.judge.run_data import ROBOT_SERVER, RunData
from deploy.reports.again import evaluated_again
from deploy.reports.verdict_texts import PARTIAL, damaged
from deploy.run.console import Console
from deploy.run.exit_codes import FAULT, FINISHED
from deploy.run.replay import Replay
from deploy.run.replay import replay as replay_run
from deploy.run.run_folder import load_run, provenance, read_manifest
from deploy.run.stop_signals import WITHIN_S, stop_at_once
from deploy.scenario.yaml_files import ScenarioError, naming


def report(
    run_dir: Annotated[
        Path, typer.Argument(help="Folder of a run, a comparison, a study or a data sheet.")
    ],
) -> None:
    """Evaluate recorded results again, and write summary.json and report.html.

    A damaged recording is evaluated as far as it can be read, with exit code 1.
    """
    folder, judge = evaluated_again(run_dir)
    with folder.lock():
        results = show_results(Console(), folder, judge)
    raise typer.Exit(FAULT if results.is_damaged else FINISHED)


def replay(
    run_dir: Annotated[Path, typer.Argument(help="Folder of a recorded run.")],
    allow_custom_law: Annotated[
        bool,
        typer.Option("--allow-custom-law", help="Run the custom law that the recording names."),
    ] = False,
) -> None:
    """Feed a recorded run to its law again, and compare the torques bit for bit."""
    data, contents = load_run(run_dir)
    _require_replayable(run_dir, data, allow_custom_law=allow_custom_law)
    stop_at_once(WITHIN_S, may_hold_lock=is_custom(data.setup.scenario.controller.law))
    with naming(run_dir):
        result = replay_run(data.setup, contents)
    stop_at_once()
    recorded = read_manifest(run_dir if run_dir.is_dir() else run_dir.parent)
    damage = all_damage(data)
    _show_replay(result, data, damage, difference_of_arithmetic(recorded, provenance()))
    raise typer.Exit(FINISHED if result.is_identical and not damage else FAULT)


def _require_replayable(run_dir: Path, data: RunData, *, allow_custom_law: bool) -> None:
    """Check that the law of a recording exists and may run."""
    law = data.setup.scenario.controller.law
    if data.setup.scenario.controller.process is not None or data.link == ROBOT_SERVER:
        raise ScenarioError(
            f"{run_dir}: {data.controller}: is not a law that funnel-hil can replay"
        )
    if is_custom(law) and not allow_custom_law:
        raise ScenarioError(
            f"{run_dir}: controller.law = {law!r}: is not a shipped law; --allow-custom-law runs"
            " the module or program of that name, which is code of the user"
        )


def _show_replay(result: Replay, data: RunData, damage: list[str], difference: str) -> None:
    console = Console()
    if damage:
        console.print(damaged(damage), markup=False)
    elif not data.complete:
        console.print(PARTIAL)
    console.print(f"recorded {result.recorded} commands, digest {result.recorded_digest}")
    console.print(f"replayed {result.replayed} commands, digest {result.digest}")
    if result.failure:
        console.print(f"the replay stopped early: {result.failure}", markup=False, highlight=False)
    if not result.is_identical:
        from_command = f" from command {result.first_difference} on"
        console.print(Text.assemble(("different", "bold red"), from_command))
        if difference:
            console.print(difference, markup=False, highlight=False)
        return
    until = " as far as can be read" if damage else " until it failed" * bool(result.failure)
    console.print(Text.assemble(("identical", "bold green"), until))
