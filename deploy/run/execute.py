"""The one way to run: execute a scenario in one process or in several, record and judge it."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property, partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Protocol

from bus_schema.recording.atomic_files import write_json
from bus_schema.runtime.child import how_it_ended, last_line
from deploy.judge.metrics import RunResult, judge
from deploy.judge.run_data import RunData
from deploy.judge.verdict import Verdict
from deploy.run.fault_record import write_fault_record
from deploy.run.network.links import free_ports
from deploy.run.network.real_delay import RealDelay
from deploy.run.processes import launcher
from deploy.run.processes.child import RunOutcome
from deploy.run.processes.status import StatusMessage, StatusReporter
from deploy.run.recording import record_failures
from deploy.run.run_folder import RunFolder, RunFolderError, load_run
from deploy.run.simulate import failed_simulation, simulate
from deploy.scenario.effective import write_scenario
from deploy.scenario.setup import Setup
from deploy.scenario.yaml_files import ScenarioError
from plant_emulator.plant_loop import PlantLoop

OnStart = Callable[[Callable[[], None]], None]
"""Called with a function that stops the run."""


class JudgedRun:
    """A run whose data is read, and whose result is computed, when first requested.

    Args:
        law: its name, or another label that distinguishes the run from others beside it.
        data: the recorded data, or a function that reads it.
        result: its result; if None, it is computed.
        path: its folder or MCAP file; None if it was not written.
        outcome: how its processes ended.
    """

    def __init__(
        self,
        law: str,
        data: RunData | Callable[[], RunData],
        result: RunResult | None = None,
        path: Path | None = None,
        outcome: RunOutcome | None = None,
    ) -> None:
        self.law, self.path = law, path
        self.outcome = RunOutcome() if outcome is None else outcome
        self._data, self._result = data, result

    @cached_property
    def data(self) -> RunData:
        """The recorded data.

        Raises:
            RunFolderError: nothing was recorded.
        """
        if callable(self._data):
            self._data = self._data()  # release the source of the data
        return self._data

    @cached_property
    def result(self) -> RunResult:
        """Its result; raises the errors of `data`."""
        return judge(self.data) if self._result is None else self._result

    @property
    def summary(self) -> dict[str, Any]:
        """Content of ``summary.json``; raises the errors of `data`."""
        return self.result.model_dump()

    @property
    def seed(self) -> int:
        return self.data.setup.scenario.seed

    @property
    def verdict(self) -> Verdict:
        """The verdict on the run."""
        return self.result.verdict

    @property
    def kept_bounds(self) -> bool:
        return self.verdict is Verdict.KEPT

    def keep(self, folder: RunFolder) -> None:
        """Write its summary, and the record of its fault, to its folder."""
        write_json(folder.summary, self.summary)
        write_fault_record(self.data, folder.fault)


class How(Protocol):
    """A way to run a scenario."""

    def run(self, setup: Setup, folder: RunFolder) -> JudgedRun:
        """Run, and record to a folder."""


@dataclass(frozen=True)
class InProcess:
    """Runs in this process and in virtual time; without a folder nothing is recorded.

    An exception of a law is a fault of the run.

    Attributes:
        on_start: called with the plant loop before it runs, to watch its progress or to stop it.
        on_end: called after the law's last call, before anything is written.
    """

    on_start: Callable[[PlantLoop], None] | None = None
    on_end: Callable[[], None] = lambda: None

    def run(self, setup: Setup, folder: RunFolder | None) -> JudgedRun:
        path, can_log = (None, None) if folder is None else (folder.path, folder.can_log)
        try:
            simulation = simulate(setup, self.on_start, can_log)
        except ScenarioError:
            raise
        except Exception as error:  # noqa: BLE001 - a user's law may raise any exception
            simulation = failed_simulation(setup, f"{type(error).__name__}: {error}")
        finally:
            self.on_end()
        messages = None if folder is None else simulation.write_log(folder.log)
        return JudgedRun(_name(setup), partial(simulation.data, messages), path=path)


@dataclass(frozen=True)
class InProcesses:
    """Runs controller, plant and recorder as processes, by the scenario's clock; needs a folder.

    Attributes:
        delay: a real delay between controller and plant; None for none.
        awaits_controller: start no controller, as one will come from elsewhere.
        viewer: what a live view does, given the run's folder; None for no live view.
        on_start: called before they start.
        on_message: called with their status messages.
    """

    delay: RealDelay | None = None
    awaits_controller: bool = False
    viewer: Callable[[Path, StatusReporter], int] | None = None
    on_start: OnStart = lambda _request_stop: None
    on_message: Callable[[StatusMessage], None] = lambda _message: None

    def run(self, setup: Setup, folder: RunFolder) -> JudgedRun:
        processes = launcher.Launcher(
            setup, folder,
            delay=self.delay, awaits_controller=self.awaits_controller, viewer=self.viewer,
        )  # fmt: skip
        self.on_start(processes.request_stop)
        outcome = processes.run(self.on_message)
        if self.delay is not None:
            outcome.relay = {"round_trip_ms": self.delay.round_trip_ms, **outcome.relay}
        folder.write_manifest(setup, outcome.realtime, outcome.relay or None)
        return recorded(folder, outcome)


@dataclass(frozen=True)
class Lockstep:
    """Runs processes in lockstep, on separate ports, below a process that starts them.

    With this, a worker of a study, or a command with several runs, can use a user's program as
    controller. A run without a recording counts as a fault.

    Attributes:
        on_start: called once they run.
    """

    on_start: OnStart = lambda _request_stop: None

    def run(self, setup: Setup, folder: RunFolder) -> JudgedRun:
        setup = lockstep_setup(setup)
        write_scenario(setup, folder.scenario)
        process = subprocess.Popen(
            [sys.executable, "-P", "-m", launcher.__name__, str(folder.path), str(os.getpid())],
            stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
            start_new_session=True,
        )  # fmt: skip
        self.on_start(process.terminate)
        output, errors = process.communicate()
        if code := process.returncode:
            last = last_line(errors) or how_it_ended(code).removeprefix("ended with ")
            failures = [f"the run failed: {last}"]
            record_failures(folder.log, failures)
        else:
            failures = json.loads(output)
        try:
            data, _ = load_run(folder.path)
        except RunFolderError as error:
            data = replace(failed_simulation(setup, str(error)).data(), failures=failures)
        return JudgedRun(
            _name(setup), data, path=folder.path, outcome=RunOutcome(failures=failures)
        )


def execute(setup: Setup, how: How | None = None, folder: RunFolder | None = None) -> JudgedRun:
    """Run a scenario.

    Args:
        setup: the scenario.
        how: by default in one process, or in lockstep if the controller is a separate process.
        folder: where to record it; without one, processes use a temporary folder.

    Raises:
        ScenarioError: it cannot be run in this way.
        OSError: the recording cannot be written.
    """
    if how is None:
        how = InProcess() if setup.scenario.controller.process is None else Lockstep()
    if isinstance(how, InProcess):
        return how.run(setup, folder)
    if folder is not None:
        return how.run(setup, folder)
    with TemporaryDirectory(prefix="funnel-hil-") as place:
        folder = RunFolder(Path(place))
        write_scenario(setup, folder.scenario)
        run = how.run(setup, folder)
        _ = run.data  # read it before its folder is removed
        run.path = None
        return run


def recorded(folder: RunFolder, outcome: RunOutcome, setup: Setup | None = None) -> JudgedRun:
    """Return the run that processes have recorded to a folder; the setup is as for `load_run`."""

    def read() -> RunData:
        data, _ = load_run(folder.path, setup)
        return replace(data, failures=data.failures or outcome.failures)  # the disk is full

    return JudgedRun(folder.path.name, read, path=folder.path, outcome=outcome)


def lockstep_setup(setup: Setup) -> Setup:
    """Return the scenario in virtual time, with free ports: parallel runs must not share any."""
    link = setup.scenario.link
    protocol = "tls" if link.security.enabled else "tcp"
    keys = ("plant_endpoint", "controller_endpoint")
    places = {
        key: f"{protocol}/127.0.0.1:{port}"
        for key, port in zip(keys, free_ports(len(keys)), strict=True)
    }
    changes = {"clock": "lockstep", "link": link.model_copy(update=places)}
    return replace(setup, scenario=setup.scenario.model_copy(update=changes))


def _name(setup: Setup) -> str:
    return setup.scenario.controller.name
