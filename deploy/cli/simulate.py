"""`funnel-hil simulate`: a scenario in this one process, in virtual time."""

from __future__ import annotations

import threading
from collections.abc import Callable

from rich.console import Console

from deploy.cli.common import (
    Out,
    Overrides,
    RequireBounds,
    ScenarioArgument,
    finish,
    on_interrupt,
)
from deploy.cli.show_run import RunProgress
from deploy.processes.launcher import RunOutcome
from deploy.processes.links import check_link
from deploy.runs.run_folder import RunFolder
from deploy.runs.simulate import simulate as simulate_setup
from deploy.scenario.scenario import load_setup
from plant_emulator.plant_loop import PlantLoop

_POLL_S = 0.1


def simulate(
    scenario: ScenarioArgument = "paper_arm",
    overrides: Overrides = None,
    out: Out = None,
    require_bounds: RequireBounds = False,
) -> None:
    """Run a scenario in one process and in virtual time."""
    setup = load_setup(scenario, overrides or [])
    check_link(setup, one_process=True)
    console = Console()
    folder = RunFolder.begin(setup, out)
    outcome = RunOutcome()
    over = threading.Event()

    with RunProgress(console, setup.scenario.name, setup.scenario.duration_s) as progress:

        def watch(loop: PlantLoop) -> None:
            def stop() -> None:
                outcome.interrupted = True
                loop.request_stop()

            on_interrupt(stop)
            _every(_POLL_S, over, lambda: progress.at(setup.grid.tick_ns(loop.tick) * 1e-9))

        try:
            simulation = simulate_setup(setup, watch, folder.can_log)
        finally:
            over.set()
    simulation.write_log(folder.log)
    finish(console, folder, outcome, require_bounds=require_bounds)


def _every(seconds: float, over: threading.Event, action: Callable[[], None]) -> None:
    """Do something again and again on a thread of its own, until `over`."""

    def repeat() -> None:
        while not over.wait(seconds):
            action()

    threading.Thread(target=repeat, daemon=True).start()
