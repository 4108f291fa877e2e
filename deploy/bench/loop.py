"""What a tick costs: physics, simulation on each engine, and the loop in lockstep and real time."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import closing
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from bus_schema.messages.run_event import EventKind
from bus_schema.messages.topics import Role
from deploy.bench.measure import Section, cost_us, interleave, ratio
from deploy.judge.metrics import summarise
from deploy.judge.run_data import RunData
from deploy.run.network.links import with_free_endpoints
from deploy.run.processes.launcher import Launcher
from deploy.run.run_folder import RunFolder, load_run
from deploy.run.simulate import simulate
from deploy.scenario.scenario import load_setup
from deploy.scenario.setup import Setup
from plant_emulator.physics.engines import ENGINES

SIMULATE = "tick of simulate"
LOCKSTEP = "tick of run in lockstep"
ROUND_TRIP = "round trip of the real loop"
WAKE_UP_P50, WAKE_UP_P99 = (
    "wake-up lateness of the plant, p50",
    "wake-up lateness of the plant, p99",
)
_PERIOD = "period of the loop"
_PAIRS = 8
"""Simulations and bare physics take no time to start, so that more of them can be compared."""
_ENGINES_COMPARED_ON = "iiwa"
_PATIENCE_MS = 2000
"""A busy machine may hold up a run for a while; that ends no measurement of medians."""


def measure_loop_costs(scenario: str, seconds: float, repetitions: int) -> Section:
    """Measure the ticks of a scenario.

    Args:
        scenario: name or path.
        seconds: length of each run on the run's clock.
        repetitions: how often everything is measured.
    """
    setup = lockstep_setup(scenario, seconds)
    section = _engines(scenario, seconds, _PAIRS * repetitions)
    other = _engines(_ENGINES_COMPARED_ON, seconds, _PAIRS * repetitions)
    costs = interleave(
        {SIMULATE: lambda: simulate_us(setup), LOCKSTEP: lambda: lockstep_us(setup)}, repetitions
    )
    ratios = [*section.ratios, *other.ratios, ratio(costs, LOCKSTEP, SIMULATE)]
    costs |= section.costs_us | other.costs_us
    return Section(f"Ticks of {setup.scenario.name}", costs, ratios)


def measure_real_time(scenario: str, seconds: float, repetitions: int) -> Section:
    """Measure a scenario's loop in real time beside its period, which all of it has to fit into.

    Args:
        scenario: name or path.
        seconds: length of each run.
        repetitions: how often everything is measured.
    """
    setup = realtime_setup(scenario, seconds)
    period_us = setup.grid.period_ns * 1e-3
    costs = interleave({"run": lambda: {**loop_us(setup), _PERIOD: period_us}}, repetitions)
    ratios = [ratio(costs, name, _PERIOD) for name in (ROUND_TRIP, WAKE_UP_P50, WAKE_UP_P99)]
    note = "Medians of each run, and the 99th percentile of wake-ups. A ratio above 1 misses ticks."
    return Section("Real time", costs, ratios, [note])


def lockstep_setup(scenario: str, seconds: float) -> Setup:
    """A scenario in lockstep, at endpoints that are free."""
    return with_free_endpoints(load_setup(scenario, _in_lockstep(seconds)))


def realtime_setup(scenario: str, seconds: float) -> Setup:
    """A scenario in real time, at endpoints that are free."""
    overrides = [
        f"duration_s={seconds}", "clock=realtime", "plant.gui=false",
        f"plant.command_timeout_ms={_PATIENCE_MS}",
    ]  # fmt: skip
    return with_free_endpoints(load_setup(scenario, overrides))


def _in_lockstep(seconds: float) -> list[str]:
    return [f"duration_s={seconds}", "clock=lockstep", "plant.gui=false"]


def _engines(scenario: str, seconds: float, repetitions: int) -> Section:
    """A scenario on every engine that is installed: simulated, and its physics alone."""
    setups = {
        f"{scenario} on {engine.title}": load_setup(
            scenario, [*_in_lockstep(seconds), f"plant.physics.engine={name}"]
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


def lockstep_us(setup: Setup) -> float:
    """Cost of one tick of a run in lockstep.

    Raises:
        RuntimeError: the run failed.
    """
    return _wall_us(_recorded_run(setup))


def loop_us(setup: Setup) -> dict[str, float]:
    """Round trip and wake-ups of a run in real time.

    Raises:
        RuntimeError: the run failed.
    """
    timing = summarise(_recorded_run(setup))["timing"]
    lateness_us = timing["wakeup_lateness_us"]
    return {
        ROUND_TRIP: timing["round_trip_us"]["p50"],
        WAKE_UP_P50: lateness_us["p50"],
        WAKE_UP_P99: lateness_us["p99"],
    }


def _recorded_run(setup: Setup) -> RunData:
    """A run with controller, plant and recorder as processes of their own."""
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
