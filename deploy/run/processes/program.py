"""``controller.process``: a user's own controller on the bus, as a process of a run."""

from __future__ import annotations

import contextlib
import os
import secrets
import shutil
import signal
from pathlib import Path

from bus_schema.configuration import ConfigurationError
from bus_schema.messages import topics
from bus_schema.messages.topics import Role
from bus_schema.runtime.child import how_it_ended
from bus_schema.zenoh.ros_graph import EntityKind, endpoint_gid, endpoint_token
from deploy.run.processes.child import SILENT, ChildProcess, Failure
from deploy.run.processes.role_process import CANNOT_START, start_program
from deploy.scenario.setup import Setup
from deploy.scenario.yaml_files import naming

_NODE = "controller_process"


def require_program(setup: Setup) -> None:
    """Check that the program of ``controller.process`` exists, before anything starts.

    Raises:
        ScenarioError: it does not.
    """
    command = setup.scenario.controller.process
    if command is not None and shutil.which(command[0]) is None:
        with naming(setup.origin):
            raise ConfigurationError(
                "controller.process", list(command),
                f"must begin with an executable program; {command[0]!r} is none in {Path.cwd()}"
                " or on the PATH",
            )  # fmt: skip


def program_variables(setup: Setup, scenario: Path, plant_endpoint: str) -> dict[str, str]:
    """Return the environment variables that describe the run to the process, besides ours.

    Args:
        setup: the scenario.
        scenario: file of its effective form.
        plant_endpoint: the plant's endpoint for the process.
    """
    link, names = setup.scenario.link, setup.robot.joint_names
    session = secrets.token_hex(16)
    token = endpoint_token(
        link.domain, session, _NODE, 1, EntityKind.PUBLISHER, topics.JOINT_COMMANDS
    )
    return {
        "FUNNEL_HIL_PLANT_ENDPOINT": plant_endpoint,
        "FUNNEL_HIL_CONTROLLER_ENDPOINT": link.controller_endpoint,
        "FUNNEL_HIL_DOMAIN": str(link.domain),
        "FUNNEL_HIL_JOINTS": ",".join(names),
        "FUNNEL_HIL_STATE_KEY": topics.JOINT_STATES.key_expression(link.domain),
        "FUNNEL_HIL_COMMAND_KEY": topics.JOINT_COMMANDS.key_expression(link.domain),
        "FUNNEL_HIL_COMMAND_TOKEN": token,
        "FUNNEL_HIL_COMMAND_GID": endpoint_gid(token).hex(),
        "FUNNEL_HIL_CLOCK": setup.scenario.clock,
        "FUNNEL_HIL_RATE_HZ": repr(setup.scenario.rate_hz),
        "FUNNEL_HIL_EVERY": str(setup.scenario.controller.every),
        "FUNNEL_HIL_DURATION_S": repr(setup.scenario.duration_s),
        "FUNNEL_HIL_SCENARIO": str(scenario.resolve()),
        "FUNNEL_HIL_URDF": str(setup.robot.path),
        "FUNNEL_HIL_SECURITY_FOLDER": str(link.security.folder) if link.security.enabled else "",
    }


class ControllerProcess(ChildProcess):
    """The process of ``controller.process``, with all processes that it starts.

    When the run is over it is asked to stop; how it then ends does not matter.

    Args:
        setup: the scenario.
        scenario: file of its effective form; the process's output is written beside it.
        plant_endpoint: the plant's endpoint for the process.
    """

    def __init__(self, setup: Setup, scenario: Path, plant_endpoint: str) -> None:
        assert setup.scenario.controller.process is not None  # otherwise there is none to start
        variables = program_variables(setup, scenario, plant_endpoint)
        self._name = setup.scenario.controller.name
        stdout, stderr = (
            scenario.with_name(f"controller_std{name}.log") for name in ("out", "err")
        )
        command = setup.scenario.controller.process
        super().__init__(Role.CONTROLLER, stderr)
        self._process = start_program(command, {**os.environ, **variables}, stdout, stderr)
        self.has_started.set()  # it never reports that it is ready

    def send(self, number: signal.Signals) -> None:
        """Send a signal to it and all processes that it started."""
        if self._process.pid is not None:
            try:
                os.killpg(self._process.pid, number)
            except ProcessLookupError:  # it has no group yet, or has ended
                super().send(number)

    def kill(self) -> None:
        """Kill it and all processes that it started, and wait until it has ended."""
        if self._process.pid is not None:
            with contextlib.suppress(ProcessLookupError):
                os.killpg(self._process.pid, signal.SIGKILL)
        super().kill()

    def failure(self) -> Failure | None:
        code = self._process.exitcode or 0
        if self._was_asked_to_stop or code == 0:
            return None
        if code == CANNOT_START:
            how = "could not be started"
        else:
            how = f"was {how_it_ended(code)}" if code < 0 else f"failed with exit code {code}"
        return Failure(f"the controller ({self._name}) {how}: {self._last_line()}", is_cause=True)

    def suspicion(self, *, plant_gave_up_first: bool) -> Failure | None:
        """Explain its possible part in a failure, if it has not failed itself.

        Args:
            plant_gave_up_first: the plant waited for it in vain and ended, which may have ended the
                program.
        """
        who, last_line = f"the controller ({self._name})", self._last_line()
        if not self._was_asked_to_stop and not plant_gave_up_first:
            return Failure(f"{who} ended by itself with exit code 0: {last_line}", is_cause=True)
        if last_line == SILENT:
            return None
        how = "had to be stopped" if self._was_asked_to_stop else "ended after the plant"
        return Failure(f"{who} {how}; end of its standard error: {last_line}", is_cause=False)
