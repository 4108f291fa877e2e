"""Compares two versions of this repository: CPU time of a tick, and of a first run that compiles.

Both run in turn on one interpreter with the same libraries, so the machine's load affects both.

    python -m scripts.benchmarks.versions OLD NEW [--quick]
"""

from __future__ import annotations

import argparse
import os
import resource
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import partial
from pathlib import Path

from llvmlite.binding import get_host_cpu_name
from rich.console import Console

from bus_schema.runtime.kernel_cache import FOLDER
from deploy.studies.bench.command import show_section
from deploy.studies.bench.measure import Costs, Section, Spread, interleave, ratio

ROOT = Path(__file__).resolve().parents[2]
KINDS = {
    "plain, MuJoCo": ["paper_arm", "plant.physics.engine=mujoco"],
    "plain, Bullet": ["paper_arm", "plant.physics.engine=bullet"],
    "compensated": ["paper_arm", "controller.delay_compensation.enabled=true"],
    "compensated, 7 joints": ["panda_motors", "controller.delay_compensation.enabled=true"],
    "over CAN": ["paper_arm_can", "link.can.interface=virtual"],
}
"""A scenario and overrides of each kind of run."""

_PROGRAM = """
import sys, time
from deploy.run.simulate import simulate
from deploy.scenario.scenario import load_setup
setup = load_setup(sys.argv[1], sys.argv[2:])
simulate(setup)
started_s = time.process_time()
simulate(setup)
print(1e6 * (time.process_time() - started_s) / setup.ticks)
"""
"""Prints the CPU time of a tick, in µs, of the second of two runs. Both versions have its names."""


def compare(
    versions: Mapping[str, Path], kinds: Sequence[str], seconds: float, repetitions: int
) -> Section:
    """Measure ticks of second runs.

    Args:
        versions: folder of each of the two versions, the older first.
        kinds: of `KINDS`.
        seconds: length of each run on its clock.
        repetitions: how often each is measured, after one run that compiles.
    """
    costs = interleave(
        {
            f"{kind}, {name}": partial(tick_us, folder, kind, seconds)
            for kind in kinds
            for name, folder in versions.items()
        },
        repetitions,
    )
    return _section("CPU time of a tick, µs", costs, list(versions), kinds)


def compare_first_runs(versions: Mapping[str, Path], kinds: Sequence[str]) -> Section:
    """Measure whole processes: imports, compilation of all kernels, and two runs of 10 ms."""
    costs = {
        f"{kind}, {name}": Spread((first_run_us(folder, kind),))
        for kind in kinds
        for name, folder in versions.items()
    }
    return _section("CPU time of a first run, µs", costs, list(versions), kinds)


def tick_us(folder: Path, kind: str, seconds: float, kernels: str | None = None) -> float:
    """Return the CPU time of a tick, in µs.

    Args:
        folder: the version's.
        kind: of `KINDS`.
        seconds: length of a run on its clock.
        kernels: folder of compiled kernels; None for the version's usual one.

    Raises:
        RuntimeError: this version cannot run it.
    """
    scenario, *overrides = KINDS[kind]
    command = [sys.executable, "-c", _PROGRAM, scenario, f"duration_s={seconds}", *overrides]
    # The packages of this copy are installed as editable, and would come first.
    sources = {"PYTHONPATH": os.pathsep.join(map(str, (folder, folder / "deploy/api")))}
    environment = {name: value for name, value in os.environ.items() if name != FOLDER} | sources
    ended = subprocess.run(
        command, cwd=folder, capture_output=True, text=True, check=False,
        env=environment if kernels is None else environment | {FOLDER: kernels},
    )  # fmt: skip
    if ended.returncode:
        raise RuntimeError(f"{folder}: {kind}: {ended.stderr.strip()[-500:]}")
    return float(ended.stdout.splitlines()[-1])


def first_run_us(folder: Path, kind: str) -> float:
    """Return the CPU time, in µs, of a process that finds no compiled kernel."""
    with tempfile.TemporaryDirectory() as kernels:
        started_us = _children_us()
        tick_us(folder, kind, 0.01, kernels)
        return _children_us() - started_us


@contextmanager
def checked_out(revisions: Sequence[str]) -> Iterator[dict[str, Path]]:
    """Yield a folder with each revision, which git removes afterwards.

    Raises:
        subprocess.CalledProcessError: there is no such revision.
    """
    with tempfile.TemporaryDirectory() as top:
        folders = {name: Path(top, str(place)) for place, name in enumerate(revisions)}
        try:
            for name, folder in folders.items():
                _git("worktree", "add", "--quiet", "--detach", str(folder), name)
            yield folders
        finally:
            for folder in folders.values():
                if folder.exists():
                    _git("worktree", "remove", "--force", str(folder))


def _git(*words: str) -> None:
    subprocess.run(["git", *words], cwd=ROOT, check=True)


def _section(title: str, costs: Costs, names: Sequence[str], kinds: Sequence[str]) -> Section:
    old, new = names
    ratios = [ratio(costs, f"{kind}, {new}", f"{kind}, {old}") for kind in kinds]
    return Section(title, costs, ratios, [f"{new} over {old}, in turn; CPU: {get_host_cpu_name()}"])


def _children_us() -> float:
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return 1e6 * (used.ru_utime + used.ru_stime)


def main() -> None:
    """Print both tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("old", metavar="OLD", help="a revision, as git names it")
    parser.add_argument("new", metavar="NEW", help="another one")
    parser.add_argument("--quick", action="store_true", help="shorter, and no first runs")
    given = parser.parse_args()
    with checked_out([given.old, given.new]) as versions:
        console = Console()
        seconds, repetitions = (0.5, 2) if given.quick else (2.0, 5)
        show_section(console, compare(versions, list(KINDS), seconds, repetitions))
        if not given.quick:
            show_section(console, compare_first_runs(versions, ["plain, MuJoCo", "compensated"]))


if __name__ == "__main__":
    main()
