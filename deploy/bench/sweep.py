"""Cost of a run in a sweep: against a bare simulation, and on two workers against one."""

from __future__ import annotations

import tempfile
import threading
import time
from pathlib import Path

from deploy.bench.measure import Section, cost_us, interleave, ratio
from deploy.run.simulate import simulate
from deploy.scenario.scenario import load_setup
from deploy.study.dask_workers import DaskWorkers
from deploy.study.folder import StudyFolder
from deploy.study.runner import carry_out
from deploy.study.sweep import Sweep

BARE = "run of simulate"
ONE = "run of a sweep on 1 worker"
TWO = "run of a sweep on 2 workers"
_DELAYS = "link.uplink.delay_ms, link.downlink.delay_ms"


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
    grid = {_DELAYS: [0.01 * index for index in range(runs)]}
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
