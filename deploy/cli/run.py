"""One run: `funnel-hil run` in three processes, `funnel-hil simulate` in this one.

What they do is in `one_run.py`, which loads all of the program: help and errors of the command line
need none of it, and what the processes of a run are forked from loads it at the same time.
"""

from __future__ import annotations

from deploy.cli.options import RunOptions, SimulateOptions, taking


@taking(RunOptions)
def run(options: RunOptions) -> None:
    """Run controller, plant and recorder as processes, and report whether bounds were kept."""
    from deploy.run.processes.role_process import prepare  # help and errors need none of it

    prepare()
    from deploy.cli.one_run import run_in_processes

    run_in_processes(options)


@taking(SimulateOptions)
def simulate(options: SimulateOptions) -> None:
    """Run a scenario in one process, in virtual time."""
    from deploy.cli.one_run import run_in_virtual_time

    run_in_virtual_time(options)
