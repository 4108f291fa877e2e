"""`funnel-hil run`: a scenario in three processes."""

from __future__ import annotations

from rich.console import Console

from bus_schema.messages.topics import Role
from deploy.cli.common import Out, Overrides, RequireBounds, ScenarioArgument, on_interrupt
from deploy.cli.finish import finish
from deploy.cli.progress import CommandProgress
from deploy.cli.show_run import telling
from deploy.processes.launcher import Launcher, with_free_endpoints
from deploy.processes.links import check_link, require_keys
from deploy.runs.run_folder import RunFolder
from deploy.scenario.scenario import load_setup


def run(
    scenario: ScenarioArgument = "paper_arm",
    overrides: Overrides = None,
    out: Out = None,
    require_bounds: RequireBounds = False,
) -> None:
    """Run controller, plant and recorder as separate processes, and judge the run."""
    setup = load_setup(scenario, with_free_endpoints(overrides or []))
    check_link(setup, one_process=False)
    require_keys(setup, *Role)
    console = Console()
    folder = RunFolder.create(setup.scenario.name, out)
    folder.write_scenario(setup)
    folder.write_manifest(setup, {})
    launcher = Launcher(setup, folder)
    on_interrupt(launcher.request_stop)
    with CommandProgress(console, setup.scenario.name, setup.scenario.duration_s, "s") as progress:
        outcome = launcher.run(telling(progress))
    folder.write_manifest(setup, outcome.grants)
    finish(console, folder, outcome, require_bounds=require_bounds)
