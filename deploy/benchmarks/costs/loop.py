"""What a tick costs: bare physics, simulation, and the loop over Zenoh in lockstep."""

from __future__ import annotations

from contextlib import closing
from pathlib import Path
from tempfile import TemporaryDirectory

from bus_schema.messages.run_event import EventKind
from bus_schema.messages.topics import Role
from deploy.benchmarks.echo import EchoPair
from deploy.benchmarks.measure import Section, cost_us, interleave, ratio
from deploy.processes.launcher import Launcher
from deploy.processes.network.links import with_free_endpoints
from deploy.runs.run_data import RunData
from deploy.runs.run_folder import RunFolder, load_run
from deploy.runs.simulate import simulate
from deploy.scenario.scenario import load_setup
from deploy.scenario.setup import Setup
from plant_emulator.arm.pybullet_arm import PybulletArm

BARE_PHYSICS = "bare pybullet calls of a tick"
SIMULATE = "tick of simulate"
PING_PONG = "bare Zenoh ping-pong"
LOCKSTEP = "tick of run in lockstep"
_EXCHANGES = 1000
_PAIRS = 8
"""Simulations and bare physics take no time to start, so that more of them can be compared."""


def measure_loop_costs(scenario: str, seconds: float, repetitions: int) -> Section:
    """Measure the ticks of a scenario.

    Args:
        scenario: name or path.
        seconds: length of each run on the run's clock.
        repetitions: how often everything is measured.
    """
    overrides = [f"duration_s={seconds}", "clock=lockstep", "plant.gui=false"]
    setup = with_free_endpoints(load_setup(scenario, overrides))
    alone = interleave(
        {BARE_PHYSICS: lambda: bare_physics_us(setup), SIMULATE: lambda: simulate_us(setup)},
        _PAIRS * repetitions,
    )
    with EchoPair("zenoh", setup.robot.joint_names, realtime=False) as pair:
        exchanging = interleave(
            {
                SIMULATE: lambda: simulate_us(setup),
                PING_PONG: lambda: pair.round_trips_us(_EXCHANGES).mean,
                LOCKSTEP: lambda: _wall_us(recorded_run(setup)),
            },
            repetitions,
        )
    ratios = [
        ratio(alone, SIMULATE, BARE_PHYSICS),
        ratio(exchanging, LOCKSTEP, (PING_PONG, SIMULATE)),
    ]
    return Section(f"Ticks of {setup.scenario.name}", exchanging | alone, ratios)


def bare_physics_us(setup: Setup) -> float:
    """Cost of the pybullet calls of one tick: set torques, step and read, for each substep."""
    torque, substeps = [0.0] * setup.robot.joints, setup.grid.substeps
    with closing(PybulletArm(setup.robot, setup.grid.substep_s)) as arm:
        arm.place(setup.start_position_rad)
        return substeps * cost_us(lambda: arm.step_bare(torque), setup.ticks * substeps)


def simulate_us(setup: Setup) -> float:
    """Cost of one tick of a simulation, all messages kept."""
    return _wall_us(simulate(setup).data())


def recorded_run(setup: Setup) -> RunData:
    """A run with controller, plant and recorder as processes of their own.

    Raises:
        RuntimeError: one of them failed.
    """
    with TemporaryDirectory() as path:
        folder = RunFolder.begin(setup, Path(path))
        launcher = Launcher(setup, scenario=folder.scenario, log=folder.log, can_log=folder.can_log)
        failures = launcher.run(lambda _: None).failures
        if failures:
            raise RuntimeError("; ".join(failures))
        return load_run(folder.path)[0]


def _wall_us(run: RunData) -> float:
    ended = run.last_values(Role.PLANT, EventKind.ENDED)
    if not ended:
        raise RuntimeError("a run did not come to its end")
    return float(ended["wall_s"]) / run.setup.ticks * 1e6
