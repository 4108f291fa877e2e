"""What a tick costs: physics, simulation on each engine, and the loop over Zenoh in lockstep."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import closing
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

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
from plant_emulator.physics.engines import ENGINES

SIMULATE = "tick of simulate"
PING_PONG = "bare Zenoh ping-pong"
LOCKSTEP = "tick of run in lockstep"
_EXCHANGES = 1000
_PAIRS = 8
"""Simulations and bare physics take no time to start, so that more of them can be compared."""
_ENGINES_COMPARED_ON = "iiwa"


def measure_loop_costs(scenario: str, seconds: float, repetitions: int) -> Section:
    """Measure the ticks of a scenario.

    Args:
        scenario: name or path.
        seconds: length of each run on the run's clock.
        repetitions: how often everything is measured.
    """
    overrides = [f"duration_s={seconds}", "clock=lockstep", "plant.gui=false"]
    setup = with_free_endpoints(load_setup(scenario, overrides))
    section = _engines(scenario, overrides, _PAIRS * repetitions)
    other = _engines(_ENGINES_COMPARED_ON, overrides, _PAIRS * repetitions)
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
        *section.ratios,
        *other.ratios,
        ratio(exchanging, LOCKSTEP, (PING_PONG, SIMULATE)),
    ]
    costs = exchanging | section.costs_us | other.costs_us
    return Section(f"Ticks of {setup.scenario.name}", costs, ratios)


def _engines(scenario: str, overrides: list[str], repetitions: int) -> Section:
    """A scenario on every engine that is installed: simulated, and its physics alone."""
    setups = {
        f"{scenario} on {engine.title}": load_setup(
            scenario, [*overrides, f"plant.physics.engine={name}"]
        )
        for name, engine in ENGINES.items()
        if engine.is_installed
    }
    candidates: dict[str, Callable[[], float]] = {}
    for name, setup in setups.items():
        candidates[f"{SIMULATE}, {name}"] = partial(simulate_us, setup)
        candidates[f"physics of a tick, {name}"] = partial(
            physics_us, setup, setup.grid.substeps, setup.ticks
        )
    costs = interleave(candidates, repetitions)
    ratios = [ratio(costs, f"{SIMULATE}, {name}", f"physics of a tick, {name}") for name in setups]
    first, *others = setups
    for kind in (SIMULATE, "physics of a tick"):
        ratios += [ratio(costs, f"{kind}, {other}", f"{kind}, {first}") for other in others]
    return Section(scenario, costs, ratios)


def physics_us(setup: Setup, substeps: int, calls: int) -> float:
    """Cost of so many substeps of an arm that falls, with all torques at its joints."""
    with closing(setup.arm()) as arm:
        arm.begin()
        arm.command(np.zeros(setup.robot.joints))
        return cost_us(lambda: arm.advance(0, substeps), calls)


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
