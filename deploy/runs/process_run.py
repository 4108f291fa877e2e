"""A run of ``controller.process`` in virtual time, for experiments over many runs.

Controller, plant and recorder are processes in lockstep, so that a run is the same under any load.
They are started by a process of their own, as workers of studies are not to start any.

    python -m deploy.runs.process_run FOLDER PARENT_PID
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

from bus_schema.runtime.signal_names import signal_name
from deploy.processes.launcher import Launcher
from deploy.processes.network.free_ports import free_ports
from deploy.processes.parent import end_with_parent
from deploy.processes.recorder import record_failures
from deploy.runs.judging.metrics import summarise
from deploy.runs.run_data import RunData
from deploy.runs.run_folder import RunFolder, RunFolderError, load_run
from deploy.runs.simulate import failed_simulation
from deploy.scenario.scenario import load_setup
from deploy.scenario.setup import Setup
from deploy.scenario.written import write_scenario
from deploy.stop_signals import on_stop

_MODULE = "deploy.runs.process_run"


class ProcessRun(NamedTuple):
    """A finished run, and what `metrics.summarise` says of it."""

    data: RunData
    summary: dict[str, Any]


def lockstep_setup(setup: Setup) -> Setup:
    """The scenario in virtual time, with free ports: runs at a time must not share any."""
    link = setup.scenario.link
    protocol = "tls" if link.security.enabled else "tcp"
    keys = ("plant_endpoint", "controller_endpoint")
    places = {
        key: f"{protocol}/127.0.0.1:{port}"
        for key, port in zip(keys, free_ports(len(keys)), strict=True)
    }
    changes = {"clock": "lockstep", "link": link.model_copy(update=places)}
    return replace(setup, scenario=setup.scenario.model_copy(update=changes))


def run_process(
    setup: Setup,
    path: Path,
    on_start: Callable[[Callable[[], None]], None] = lambda _request_stop: None,
) -> ProcessRun:
    """Run a scenario with its process, and judge the run.

    Args:
        setup: the scenario.
        path: an existing folder for the recording and what the process says.
        on_start: called with a function by which the run can be stopped.
    """
    setup = lockstep_setup(setup)
    write_scenario(setup, RunFolder(path).scenario)
    process = subprocess.Popen(
        [sys.executable, "-m", _MODULE, str(path), str(os.getpid())],
        stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
        start_new_session=True,
    )  # fmt: skip
    on_start(process.terminate)
    said, errors = process.communicate()
    if process.returncode:
        code = process.returncode
        how = f"exit code {code}" if code > 0 else f"killed by {signal_name(-code)}"
        last = (errors.strip() or how).splitlines()[-1]
        failures = [f"the run failed: {last}"]
        record_failures(RunFolder(path).log, failures)
    else:
        failures = json.loads(said)
    try:
        data, _ = load_run(path)
    except RunFolderError as error:
        data = replace(failed_simulation(setup, str(error)).data(), failures=failures)
    return ProcessRun(data, summarise(data))


def _main(path: Path, parent_pid: int) -> None:
    """Be the process that starts the others; writes their failures to standard output."""
    folder = RunFolder(path)
    setup = load_setup(str(folder.scenario))
    launcher = Launcher(setup, scenario=folder.scenario, log=folder.log, can_log=folder.can_log)
    on_stop(launcher.request_stop)
    end_with_parent(parent_pid)
    outcome = launcher.run(lambda _message: None)
    print(json.dumps(outcome.failures))


if __name__ == "__main__":
    _main(Path(sys.argv[1]), int(sys.argv[2]))
