"""Serve an emulated robot to its vendor's client, and record the run."""

from __future__ import annotations

import socket
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from typing import Any, NamedTuple

from bus_schema.messages.run_event import EventKind
from bus_schema.runtime.clock import MonotonicClock
from deploy.run.asked_motion import AskedMotion
from deploy.run.execute import JudgedRun, recorded
from deploy.run.network.robot_network import RobotNetwork, listening
from deploy.run.processes.child import RunOutcome
from deploy.run.run_folder import RunFolder
from deploy.run.served_run import ServedRun
from deploy.scenario.definition import LONGEST_S
from deploy.scenario.scenario import load_setup
from deploy.scenario.setup import Setup
from deploy.scenario.yaml_files import ScenarioError, override
from plant_emulator.robot_servers.robot_rig import RobotRig
from plant_emulator.robot_servers.robot_server import RobotServer

REFERENCE_FILE = "asked.csv"


class Place(NamedTuple):
    """Address at which a server listens, and of the client that it calls.

    Attributes:
        ports: numbers of its ports, by what they are for.
    """

    host: str
    client: str
    ports: Mapping[str, int]

    def words(self, server: RobotServer) -> str:
        """Say where clients find the robot, or it them."""
        ports = ", ".join(f"{name} {port}" for name, port in self.ports.items())
        if server.calls_client:
            return f"sends from {self.host} to {self.client}: {ports}"
        return f"listens at {self.host}: {ports}"


class ServedRobot:
    """A robot whose clients move it, from its start to its end.

    Args:
        setup: the scenario.
        server_type: answers the clients.
        kind: the robot's interface; its section has the server's settings.
        place: where.
        say: called with each sentence for the user.
    """

    def __init__(
        self, setup: Setup, server_type: type[RobotServer], kind: str, place: Place,
        say: Callable[[str], None],
    ) -> None:  # fmt: skip
        self._setup, self._place, self._say = setup, place, say
        self._network = network_of(setup)
        self._clock, self._kind = MonotonicClock(), kind
        interface = setup.scenario.plant.interface.model_copy(update={"kind": kind})
        self._server = server_type(interface.settings, interface.period_s, self._report)
        self._server.description = setup.robot
        self._arm = setup.arm()
        self._arm.be_controlled_by(setup.robot_controller(self._server.interface))
        self._asked = AskedMotion(
            1e-9 * setup.grid.period_ns, setup.robot.lower_rad, setup.robot.upper_rad
        )
        self._rig = RobotRig(self._arm, self._server, self._clock, setup.grid, self._record)
        self.request_stop = self._rig.request_stop

    @contextmanager
    def opened(self) -> Iterator[None]:
        """Keep its ports open.

        Raises:
            ScenarioError: a port is taken, or an address is unknown.
        """
        with open_robot(self._server, self._network, self._place):
            yield

    def run(self, folder: RunFolder, ticks: int | None) -> JudgedRun:
        """Run for a number of ticks, or until a stop is requested; return the recorded run.

        Its ports have to be open. The longest duration of a scenario ends it, too.
        """
        self._folder, network = folder, self._network
        self._run = ServedRun(self._setup, folder, self._arm)
        self._clock.start()
        most_ticks = round(LONGEST_S * 1e9) // self._setup.grid.period_ns
        self._say(f"{self._setup.scenario.name} {self._place.words(self._server)}")
        try:
            self._rig.run(most_ticks if ticks is None else ticks)
        finally:
            self._arm.close()
            self._server.close()
            if network is not None:
                network.close()
        is_whole = ticks is None or self._rig.ticks >= ticks
        judged = self._judged_or_given()
        counts = self._counts(None if network is None else network.counts())
        self._run.close(judged, counts, ticks=self._rig.ticks, completed=is_whole)
        folder.write_scenario(judged)
        if judged is not self._setup:
            (folder.path / REFERENCE_FILE).unlink()  # the scenario has a copy
        return recorded(folder, RunOutcome(interrupted=not is_whole))

    def _report(self, sentence: str) -> None:
        self._say(f"{self._clock.now_ns() * 1e-9:9.4f}  {sentence}")

    def _record(self, tick: int, was_skipped: bool) -> None:
        target_rad = self._server.target_rad
        if not target_rad.size:  # before the first cycle
            target_rad = self._arm.measured[0] + float("nan")
        now_s = 1e-9 * self._setup.grid.tick_ns(tick)
        self._asked.add(now_s, self._arm.measured[0], target_rad)
        self._run.tick(tick, target_rad, was_skipped=was_skipped)

    def _judged_or_given(self) -> Setup:
        """Return the scenario that judges the run; if it cannot be built, that is a fault of it."""
        try:
            return self._judged_setup()
        except (ScenarioError, OSError, MemoryError) as error:
            folder = self._folder.path
            sentence = f"what the client asked for cannot judge the run in {folder}: {error!s}"
            self._say(sentence)
            now_ns = self._rig.ticks * self._setup.grid.period_ns
            self._run.note(now_ns, EventKind.FAULT, sentence)
            return self._setup

    def _judged_setup(self) -> Setup:
        """Return the scenario with what the client asked for as its reference."""
        setup = self._setup
        duration_s = max(1, self._rig.ticks) * setup.grid.period_ns * 1e-9
        from_s = self._asked.first_s or 0.0  # what came before it is no error of the client's
        words = [override("duration_s", duration_s), override("metrics.from_s", from_s)]
        words += [
            override(f"plant.interface.{self._kind}.{key}", value)
            for key, value in self._server.client_settings.items()
        ]
        file = self._folder.path / REFERENCE_FILE
        self._asked.write(file, setup.robot.joint_names)
        reference = {"kind": "csv", "file": str(file), "beyond": "hold"}
        words.append(override("reference", reference))
        return load_setup(str(self._folder.scenario), words)

    def _counts(self, network: dict[str, Any] | None) -> dict[str, Any]:
        """Return the counts of the run, as plants report them; note the robot's own stops."""
        found = network or {}
        for stop in self._server.counts.get("stops", []):
            if stop["is_fault"]:
                now_ns = round(1e9 * stop["time_s"])
                self._run.note(now_ns, EventKind.FAULT, f"the robot stopped: {stop['reason']}")
        ways = {way: found[way] | {"rejected": {}} for way in ("uplink", "downlink") if found}
        late = {f"network_{key}": found[key] for key in ("chunks", "lateness_us") if found}
        own = {
            "interface": self._kind, "skipped": self._rig.skipped, **self._server.counts, **late,
            "first_target_s": self._asked.first_s, "last_target_s": self._asked.last_s,
        }  # fmt: skip
        return {**ways, "limits": {}, "robot_server": own}


@contextmanager
def open_robot(server: RobotServer, network: RobotNetwork | None, place: Place) -> Iterator[None]:
    """Open the server's ports; errors of the addresses name the options."""
    with ExitStack() as stack:
        try:
            server.client_host = socket.gethostbyname(place.client)
            stack.enter_context(listening(server, place.host, network, place.ports))
        except (OSError, UnicodeError) as error:
            what = f"--host {place.host}" + (f" --client {place.client}" * server.calls_client)
            words = getattr(error, "strerror", None) or error
            raise ScenarioError(f"{what}: {words}") from error
        yield


def network_of(setup: Setup) -> RobotNetwork | None:
    """Return the emulated network of a scenario; None if its link neither delays nor loses."""
    link = setup.link
    if not any(not way.is_constant or way.delay_ms for way in (link.uplink, link.downlink)):
        return None
    return RobotNetwork(link, setup.scenario.seed)
