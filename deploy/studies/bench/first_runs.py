"""CPU time of a first run, which compiles all of its kernels, beside that of the next."""

from __future__ import annotations

import os
import platform
import resource
import subprocess
import sys
import tempfile
from pathlib import Path

from bus_schema.runtime.compiled import HAS_SAID
from bus_schema.runtime.kernel_cache import FOLDER
from deploy.studies.bench.measure import Section, Spread, ratio

KINDS = {"plain": [], "compensated": ["controller.delay_compensation.enabled=true"]}
"""Overrides of each kind of run."""
_PROGRAM = """
import sys
from deploy.run.simulate import simulate
from deploy.scenario.scenario import load_setup
simulate(load_setup(sys.argv[1], ["duration_s=0.01", *sys.argv[2:]]))
"""


def measure_first_runs(scenario: str) -> Section:
    """Measure processes that simulate 10 ms, with an empty folder of kernels and with a full one.

    Args:
        scenario: name or path.

    Raises:
        RuntimeError: it does not run.
    """
    costs, notes = {}, [f"CPU: {_cpu()}"]
    for kind, overrides in KINDS.items():
        with tempfile.TemporaryDirectory() as kernels:
            first_s, next_s = (cpu_s(scenario, overrides, kernels) for _ in range(2))
        costs[f"first {kind}"] = Spread((1e6 * first_s,))
        costs[f"next {kind}"] = Spread((1e6 * next_s,))
        notes.append(f"{kind}: cold {first_s:.1f} s, warm {next_s:.1f} s of CPU")
    ratios = [ratio(costs, f"first {kind}", f"next {kind}") for kind in KINDS]
    return Section(f"First runs of {scenario}", costs, ratios, notes)


def cpu_s(scenario: str, overrides: list[str], kernels: str) -> float:
    """Return the CPU time of a whole process, user and system."""
    started_s = _children_s()
    ended = subprocess.run(
        [sys.executable, "-c", _PROGRAM, scenario, *overrides],
        capture_output=True, text=True, check=False,
        env=os.environ | {FOLDER: kernels, HAS_SAID: "1"},
    )  # fmt: skip
    if ended.returncode:
        raise RuntimeError(ended.stderr.strip()[-500:])
    return _children_s() - started_s


def _children_s() -> float:
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def _cpu() -> str:
    """Return the name of the CPU's model, or of its architecture where Linux does not tell it."""
    for line in Path("/proc/cpuinfo").read_text().splitlines():
        key, _, value = line.partition(":")
        if key.strip() == "model name":
            return value.strip()
    return platform.machine()
