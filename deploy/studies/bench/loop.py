"""Cost of a tick, simulated, in lockstep and in real time, and of a run in a sweep."""

from __future__ import annotations

import itertools
import tempfile
import threading
import time
from collections.abc import Callable
from contextlib import closing
from functools import partial
from pathlib import Path

import numpy as np

from bus_schema.messages.run_event import EventKind
from bus_schema.messages.topics import Role
from controller.control_law import Tracking
from controller.laws import torque_laws
from controller.torque_guard import TorqueGuard
from deploy.judge.run_data import RunData
from deploy.run.execute import InProcesses, JudgedRun, execute
from deploy.run.network.links import with_free_endpoints
from deploy.run.simulate import simulate
from deploy.scenario import study_keys
from deploy.scenario.scenario import load_setup
from deploy.scenario.setup import Setup
from deploy.studies.bench.measure import Section, cost_us, interleave, ratio
from deploy.studies.sweep.sweep import Sweep
from deploy.study.execution.dask_workers import DaskWorkers
from deploy.study.execution.folder import StudyFolder
from deploy.study.execution.runner import carry_out
from plant_emulator.physics.engines import ENGINES

SIMULATE = "tick of simulate"
LOCKSTEP = "tick of run in lockstep"
ROUND_TRIP = "round trip of the real loop"
WAKE_UP_P50, WAKE_UP_P99 = (f"wake-up lateness of the plant, {each}" for each in ("p50", "p99"))
_PERIOD = "period of the loop"
BARE = "run of simulate"
ONE = "run of a sweep on 1 worker"
TWO = "run of a sweep on 2 workers"
_PAIRS = 8
"""Simulations and bare physics start instantly, so more of them are compared."""
_ENGINES_COMPARED_ON = "iiwa"
_ARMS = ("paper_arm", "iiwa")
_SITUATIONS = 256
_SETTLED_S = 2.0
_ERROR_RAD, _ERROR_RATE_RAD_S = 1e-4, 1e-3
_PATIENCE_MS = 2000
"""A busy machine may delay a run for a while; that must not end a measurement of medians."""


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
    """Measure a scenario's loop in real time, beside its period, into which it has to fit.

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
    """Return a scenario in lockstep, at free endpoints."""
    return with_free_endpoints(load_setup(scenario, _in_lockstep(seconds)))


def realtime_setup(scenario: str, seconds: float) -> Setup:
    """Return a scenario in real time, at free endpoints."""
    overrides = [
        f"duration_s={seconds}", "clock=realtime", "plant.gui=false",
        f"plant.command_timeout_ms={_PATIENCE_MS}",
    ]  # fmt: skip
    return with_free_endpoints(load_setup(scenario, overrides))


def _in_lockstep(seconds: float) -> list[str]:
    return [f"duration_s={seconds}", "clock=lockstep", "plant.gui=false"]


def _engines(scenario: str, seconds: float, repetitions: int) -> Section:
    """Return a scenario on every installed engine: simulated, and its physics alone."""
    setups = {
        f"{scenario} on {engine.title}": load_setup(
            scenario, [*_in_lockstep(seconds), f"plant.physics.engine={name}"]
        )
        for name, engine in ENGINES.usable().items()
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


def measure_control_steps(steps: int, repetitions: int) -> Section:
    """Measure every law of torques, and a step of physics, on arms of 3 and 7 joints.

    Args:
        steps: control steps, and steps of physics, in each measurement.
        repetitions: how often everything is measured.
    """
    candidates: dict[str, Callable[[], float]] = {}
    pairs = []
    for scenario in _ARMS:
        setup = load_setup(scenario)
        joints = f"{setup.robot.joints} joints"
        physics = f"step of physics, {joints}"
        candidates[physics] = partial(physics_us, setup, 1, steps)
        for law in torque_laws():
            step = _control_step(load_setup(scenario, [f"controller.law={law}"]))
            candidates[f"{law}, {joints}"] = partial(cost_us, step, steps)
            pairs.append((f"{law}, {joints}", physics))
    costs = interleave(candidates, repetitions)
    ratios = [ratio(costs, step, physics) for step, physics in pairs]
    note = "A control step is reference, errors, bounds, law and torque limits; no message."
    return Section("Control step", costs, ratios, [note])


def _control_step(setup: Setup) -> Callable[[], None]:
    """Return a law's control step, applied to many situations near the reference in turn."""
    task, tracking = setup.control_task(), Tracking(setup.robot.joints)
    step_s = setup.grid.period_ns * 1e-9
    guard = TorqueGuard(task.law_name, task.limits, tracking.motion)
    waves = np.sin(np.arange(_SITUATIONS)[:, None] + np.arange(setup.robot.joints))
    situations = []
    for tick, wave in enumerate(waves):
        time_s = _SETTLED_S + tick * step_s
        tracking.update(time_s, 0.0, task.reference, task.funnel)
        position = tracking.reference_position + _ERROR_RAD * wave
        velocity = tracking.reference_velocity + _ERROR_RATE_RAD_S * wave
        situations.append((time_s, position, velocity))
    in_turn = itertools.cycle(situations)
    task.law.reset()

    def step() -> None:
        time_s, tracking.position[:], tracking.velocity[:] = next(in_turn)
        tracking.update(time_s, step_s, task.reference, task.funnel)
        guard.admit(task.law.torque(tracking), 0, tracking.step_s)

    return step


def physics_us(setup: Setup, substeps: int, calls: int) -> float:
    """Return the cost of so many substeps of a falling arm, with all torques at its joints."""
    with closing(setup.arm()) as arm:
        arm.begin()
        arm.command(np.zeros(setup.robot.joints))
        return cost_us(lambda: arm.advance(0, substeps), calls)


def simulate_us(setup: Setup) -> float:
    """Return the cost of one tick of a simulation, with all messages kept."""
    return _wall_us(simulate(setup).data())


def lockstep_us(setup: Setup) -> float:
    """Return the cost of one tick of a run in lockstep.

    Raises:
        RuntimeError: the run failed.
    """
    return _wall_us(_run_in_processes(setup).data)


def loop_us(setup: Setup) -> dict[str, float]:
    """Return round trip and wake-ups of a run in real time.

    Raises:
        RuntimeError: the run failed.
    """
    timing = _run_in_processes(setup).summary["timing"]
    lateness_us = timing["wakeup_lateness_us"]
    return {
        ROUND_TRIP: timing["round_trip_us"]["p50"],
        WAKE_UP_P50: lateness_us["p50"],
        WAKE_UP_P99: lateness_us["p99"],
    }


def _run_in_processes(setup: Setup) -> JudgedRun:
    run = execute(setup, InProcesses())
    if run.outcome.failures:
        raise RuntimeError("; ".join(run.outcome.failures))
    return run


def _wall_us(run: RunData) -> float:
    ended = run.last_values(Role.PLANT, EventKind.ENDED)
    if not ended:
        raise RuntimeError("a run did not come to its end")
    return float(ended["wall_s"]) / run.setup.ticks * 1e6


def measure_sweep(scenario: str, seconds: float, runs: int, repetitions: int) -> Section:
    """Measure a sweep of short runs, and as many bare simulations in this process.

    Args:
        scenario: name or path.
        seconds: length of each run on the run's clock.
        runs: number of runs; the workers are warm before the first.
        repetitions: how often everything is measured.
    """
    overrides = [f"duration_s={seconds}", "metrics.from_s=0"]
    setup = load_setup(scenario, overrides)
    grid = {", ".join(study_keys.DELAYS): [0.01 * index for index in range(runs)]}
    fixed = {"duration_s": seconds, "metrics.from_s": 0}
    values = {"name": "bench", "scenario": scenario, "set": fixed, "grid": grid}
    sweep = Sweep(values, Path("bench"))
    with DaskWorkers(1) as one, DaskWorkers(2) as two:
        costs = interleave(
            {
                BARE: lambda: cost_us(lambda: simulate(setup), runs),
                ONE: lambda: _sweep_us(sweep, one),
                TWO: lambda: _sweep_us(sweep, two),
            },
            repetitions,
        )
    ratios = [ratio(costs, ONE, BARE), ratio(costs, ONE, TWO)]
    notes = [f"Each is {runs} runs of {seconds:g} s; sweeps write rows, scenarios and table too."]
    return Section(f"Sweep of {setup.scenario.name}", costs, ratios, notes)


def _sweep_us(sweep: Sweep, workers: DaskWorkers) -> float:
    """Return the cost of one run of a whole sweep, in µs of wall time."""
    with tempfile.TemporaryDirectory() as path:
        folder = StudyFolder(Path(path), sweep)
        started_ns = time.perf_counter_ns()
        carry_out(sweep, workers, folder, threading.Event())
        folder.write(completed=True)
        return (time.perf_counter_ns() - started_ns) / sweep.expected * 1e-3
