"""One run: `funnel-hil run` in three processes, `funnel-hil simulate` in this one.

`run_and_simulate.py` does the work and loads the whole program. Help and errors need none of it;
`run` starts the fork server first, which loads the program at the same time.
"""

from __future__ import annotations

from deploy.cli.parts.options import RunOptions, SimulateOptions, taking


@taking(RunOptions)
def run(options: RunOptions) -> None:
    """Run controller, plant and recorder as processes, and report whether bounds were kept."""
    from deploy.run.processes.role_process import prepare  # help and errors need none of it

    prepare()
    from deploy.cli.run_and_simulate import run_in_processes

    run_in_processes(options)


@taking(SimulateOptions)
def simulate(options: SimulateOptions) -> None:
    """Run a scenario in one process, in virtual time."""
    from deploy.cli.run_and_simulate import run_in_virtual_time

    run_in_virtual_time(options)
