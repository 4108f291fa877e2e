"""The one way to run: a scenario is executed in one process or in several, recorded and judged.

As a program, ``python -m deploy.run.execute FOLDER PARENT_PID`` starts the processes of a run, as
a worker of a study must not: they belong to a process of their own, which ends with its parent.
"""

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
from bus_schema.runtime.signal_names import signal_name
from deploy.judge.metrics import summarise
from deploy.judge.run_data import RunData
from deploy.judge.verdict import Verdict, verdict_of
from deploy.run.fault_record import fault_record
from deploy.run.network.links import free_ports
from deploy.run.network.real_delay import RealDelay
from deploy.run.processes.child import RunOutcome
from deploy.run.processes.launcher import Launcher
from deploy.run.processes.recorder import record_failures
from deploy.run.processes.role_process import end_with_parent
from deploy.run.processes.status import StatusMessage, StatusReporter
from deploy.run.run_folder import RunFolder, RunFolderError, load_run
from deploy.run.simulate import failed_simulation, simulate
from deploy.run.stop_signals import on_stop
from deploy.scenario.effective import write_scenario
from deploy.scenario.scenario import load_setup
from deploy.scenario.setup import Setup
from deploy.scenario.yaml_files import ScenarioError
from plant_emulator.plant_loop import PlantLoop

OnStart = Callable[[Callable[[], None]], None]
"""Is called with a function by which a run can be stopped."""


class JudgedRun:
    """A run, which is read and judged when its data or summary is first asked for.

    Args:
        law: its name, or what else tells the run from those beside it.
        data: all that was recorded, or what reads it.
        summary: what ``summary.json`` says; it is judged if None.
        path: its folder or MCAP file; None where it was not written.
        outcome: how its processes ended.
    """

    def __init__(
        self,
        law: str,
        data: RunData | Callable[[], RunData],
        summary: dict[str, Any] | None = None,
        path: Path | None = None,
        outcome: RunOutcome | None = None,
    ) -> None:
        self.law, self.path = law, path
        self.outcome = RunOutcome() if outcome is None else outcome
        self._data, self._summary = data, summary

    @cached_property
    def data(self) -> RunData:
        """All that was recorded.

        Raises:
            RunFolderError: nothing was.
        """
        if callable(self._data):
            self._data = self._data()  # what it was made of is not kept
        return self._data

    @cached_property
    def summary(self) -> dict[str, Any]:
        """What ``summary.json`` says; errors as `data`."""
        return summarise(self.data) if self._summary is None else self._summary

    @property
    def seed(self) -> int:
        return self.data.setup.scenario.seed

    @property
    def verdict(self) -> Verdict:
        """What became of it."""
        return verdict_of(self.summary)

    @property
    def kept_bounds(self) -> bool:
        return self.verdict is Verdict.KEPT

    def keep(self, folder: RunFolder) -> None:
        """Write its summary, and the record of its fault, to its folder."""
        write_json(folder.summary, self.summary)
        if (record := fault_record(self.data)) is not None:
            write_json(folder.fault, record)


class How(Protocol):
    """A way to run a scenario."""

    def run(self, setup: Setup, folder: RunFolder | None) -> JudgedRun:
        """Run, and record to a folder."""


@dataclass(frozen=True)
class InProcess:
    """In this process and in virtual time; without a folder nothing is recorded.

    Whatever a law raises is a fault of the run.

    Attributes:
        on_start: called with the plant loop before it runs, to watch its progress or to stop it.
        on_end: called once the law has been called for the last time, before anything is written.
    """

    on_start: Callable[[PlantLoop], None] | None = None
    on_end: Callable[[], None] = lambda: None

    def run(self, setup: Setup, folder: RunFolder | None) -> JudgedRun:
        path, can_log = (None, None) if folder is None else (folder.path, folder.can_log)
        try:
            simulation = simulate(setup, self.on_start, can_log)
        except ScenarioError:
            raise
        except Exception as error:  # noqa: BLE001 - a law of the user's own may raise anything
            simulation = failed_simulation(setup, f"{type(error).__name__}: {error}")
        finally:
            self.on_end()
        messages = None if folder is None else simulation.write_log(folder.log)
        return JudgedRun(_name(setup), partial(simulation.data, messages), path=path)


@dataclass(frozen=True)
class InProcesses:
    """Controller, plant and recorder as processes, by the scenario's clock; needs a folder.

    Attributes:
        delay: a real delay between controller and plant; None for none.
        awaits_controller: start no controller, as one will come from elsewhere.
        viewer: what a live view does, given the run's folder; None for no live view.
        on_start: called before they start.
        on_message: called with what they report.
    """

    delay: RealDelay | None = None
    awaits_controller: bool = False
    viewer: Callable[[Path, StatusReporter], int] | None = None
    on_start: OnStart = lambda _request_stop: None
    on_message: Callable[[StatusMessage], None] = lambda _message: None

    def run(self, setup: Setup, folder: RunFolder | None) -> JudgedRun:
        assert folder is not None
        launcher = Launcher(
            setup, scenario=folder.scenario, log=folder.log, can_log=folder.can_log,
            delay=self.delay, awaits_controller=self.awaits_controller, viewer=self.viewer,
        )  # fmt: skip
        self.on_start(launcher.request_stop)
        outcome = launcher.run(self.on_message)
        if self.delay is not None:
            outcome.relay = {"round_trip_ms": self.delay.round_trip_ms, **outcome.relay}
        folder.write_manifest(setup, outcome.realtime, outcome.relay or None)
        return recorded(folder, outcome)


@dataclass(frozen=True)
class Lockstep:
    """Processes in lockstep, with ports of their own, below a process that starts them.

    So a worker of a study, or a command with other runs behind it, runs a program of the user's
    own as controller. A run that leaves no recording is one with a fault.

    Attributes:
        on_start: called once they run.
    """

    on_start: OnStart = lambda _request_stop: None

    def run(self, setup: Setup, folder: RunFolder | None) -> JudgedRun:
        assert folder is not None
        setup = lockstep_setup(setup)
        write_scenario(setup, folder.scenario)
        process = subprocess.Popen(
            [sys.executable, "-m", "deploy.run.execute", str(folder.path), str(os.getpid())],
            stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
            start_new_session=True,
        )  # fmt: skip
        self.on_start(process.terminate)
        said, errors = process.communicate()
        if code := process.returncode:
            how = f"exit code {code}" if code > 0 else f"killed by {signal_name(-code)}"
            last = (errors.strip() or how).splitlines()[-1]
            failures = [f"the run failed: {last}"]
            record_failures(folder.log, failures)
        else:
            failures = json.loads(said)
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
        how: in one process by default, or in lockstep where the controller is a process of its own.
        folder: where to record it; without one, processes take one for the time of the run.

    Raises:
        ScenarioError: it cannot be run that way.
        OSError: the disk does not take the recording.
    """
    if how is None:
        how = InProcess() if setup.scenario.controller.process is None else Lockstep()
    if folder is not None or isinstance(how, InProcess):
        return how.run(setup, folder)
    with TemporaryDirectory(prefix="funnel-hil-") as place:
        folder = RunFolder(Path(place))
        write_scenario(setup, folder.scenario)
        run = how.run(setup, folder)
        _ = run.data  # is read before its folder goes
        run.path = None
        return run


def recorded(folder: RunFolder, outcome: RunOutcome) -> JudgedRun:
    """The run that processes have recorded to a folder."""

    def read() -> RunData:
        data, _ = load_run(folder.path)
        return replace(data, failures=data.failures or outcome.failures)  # of a disk that is full

    return JudgedRun(folder.path.name, read, path=folder.path, outcome=outcome)


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


def _name(setup: Setup) -> str:
    return setup.scenario.controller.name


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
