"""A long run in real time on a busy machine with a slow disk: nothing may grow, nothing be lost.

`scripts/soak [--minutes 10]`: controller, plant and recorder, a process that burns time on every
core, and the memory of the three sampled once a second. Then the recording is counted again.
"""

from __future__ import annotations

import argparse
import contextlib
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from rich.console import Console
from rich.table import Table

from bus_schema.messages import topics
from bus_schema.recording.atomic_files import partial_path
from deploy.judge.metrics import summarise
from deploy.judge.run_data import RunData
from deploy.run.network.links import free_ports
from deploy.run.run_folder import load_run

_SAMPLE_S = 1.0
_WARM_UP_SHARE, _SHORTEST_WARM_UP_S = 0.2, 45.0
"""The recorder's mailbox has places for 40 s of messages; each takes memory when first used."""
_LARGEST_GROWTH = 0.05
_MIB = 1 << 20
_ONE_SECOND_BYTES = 200_000
_BURN = "while True: pass"


class Check(NamedTuple):
    """One thing that must hold."""

    what: str
    found: str
    holds: bool


def soak(minutes: float, folder: Path) -> list[Check]:
    """Run for so long; what must hold, and whether it did."""
    overrides, log = _overrides(minutes), folder / "run.mcap"
    folder.mkdir(parents=True, exist_ok=True)
    words = [word for override in overrides for word in ("--set", override)]
    roles = {
        "recorder": ["scripts.benchmarks.slow_recorder", "paper_arm", str(log), *overrides],
        "plant": ["deploy.cli", "plant", "paper_arm", "--await-recorder", *words],
        "controller": ["deploy.cli", "controller", "paper_arm", "--await-recorder", *words],
    }
    with contextlib.ExitStack() as stack:

        def start(*words: str) -> subprocess.Popen[bytes]:
            command = [sys.executable, *words]
            process = stack.enter_context(subprocess.Popen(command, stdout=subprocess.DEVNULL))
            stack.callback(process.kill)
            return process

        for _ in range(os.cpu_count() or 1):
            start("-c", _BURN)
        processes = {role: start("-m", *words) for role, words in roles.items()}
        samples = _sample(processes, partial_path(log))
        codes = {role: process.wait() for role, process in processes.items()}
    checks = [
        Check(f"{role} ended well", f"code {code}", code == 0) for role, code in codes.items()
    ]
    checks += [_memory(role, np.array(sizes)) for role, sizes in samples.items()]
    data, _ = load_run(folder)
    return checks + _counts(data, summarise(data))


def _overrides(minutes: float) -> list[str]:
    """The shipped arm on a path that does not sink, so that it may go on for hours."""
    plant_port, controller_port = free_ports(2)
    return [
        f"duration_s={60 * minutes}",
        "reference.x.velocity_m_s=0",
        "plant.command_timeout_ms=2000",
        f"link.plant_endpoint=tcp/127.0.0.1:{plant_port}",
        f"link.controller_endpoint=tcp/127.0.0.1:{controller_port}",
    ]


def _sample(processes: dict[str, subprocess.Popen[bytes]], recording: Path) -> dict[str, list[int]]:
    """Resident memory of every process, bytes, once a second from when the loops run."""
    while not _has_begun(recording) and all(p.poll() is None for p in processes.values()):
        time.sleep(_SAMPLE_S)
    samples: dict[str, list[int]] = {role: [] for role in processes}
    page = os.sysconf("SC_PAGE_SIZE")
    while all(process.poll() is None for process in processes.values()):
        for role, process in processes.items():
            with contextlib.suppress(OSError):
                pages = Path(f"/proc/{process.pid}/statm").read_text().split()[1]
                samples[role].append(int(pages) * page)
        time.sleep(_SAMPLE_S)
    return samples


def _has_begun(recording: Path) -> bool:
    return recording.exists() and recording.stat().st_size > _ONE_SECOND_BYTES


def _memory(role: str, sizes: np.ndarray[Any, Any]) -> Check:
    """Growth from just after the warm-up to the last tenth; the very last samples are farewells."""
    warm = max(round(_WARM_UP_SHARE * len(sizes)), round(_SHORTEST_WARM_UP_S / _SAMPLE_S))
    steady = sizes[warm:-2]
    if len(steady) < 2:
        return Check(f"{role}: memory flat", "too short a run to tell", holds=False)
    tenth = max(1, len(steady) // 10)
    before, after = np.median(steady[:tenth]), np.median(steady[-tenth:])
    growth = float(after / before - 1.0)
    found = f"{before / _MIB:.1f} → {after / _MIB:.1f} MiB ({100 * growth:+.2f} %)"
    return Check(f"{role}: memory flat", found, growth <= _LARGEST_GROWTH)


def _counts(data: RunData, summary: dict[str, Any]) -> list[Check]:
    """Counts of the summary against the recording, counted once more."""
    truth = data.tables[topics.PLANT_TRUTH.name]
    setup, ticks = data.setup, data.setup.ticks
    missing = ticks + 1 - len(np.unique(truth["timing.cycle"]))
    skipped, reported = (
        int((truth["timing.lateness_ns"] < 0).sum()),
        int(truth["timing.skipped"][-1]),
    )
    deadline_ns = setup.scenario.link.deadline_ns(setup.grid.period_ns, 0)
    age_ns = np.where(truth["command_age_ns"] < 0, data.times_s(topics.PLANT_TRUTH) * 1e9,
                      truth["command_age_ns"])  # fmt: skip
    misses, counted = int((age_ns > deadline_ns + 0.5).sum()), summary["timing"]["deadline_misses"]
    lost = summary["recorder"]["lost"]
    return [
        Check("run completed", str(summary["faults"] or "no fault"), summary["completed"]),
        Check("bounds kept", summary["verdict"], summary["bounds"]["kept"]),
        Check("no record lost", f"{lost} of {data.messages}", lost == 0),
        Check("every tick recorded", f"{missing} of {ticks + 1} missing", missing == 0),
        Check("misses counted exactly", f"{counted}, recounted {misses}", counted == misses),
        Check("skips counted exactly", f"{reported}, recounted {skipped}", reported == skipped),
    ]


def main() -> None:
    """Soak, show the table; exit code 1 if anything did not hold."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--minutes", type=float, default=10.0)
    parser.add_argument("--out", type=Path, help="keep the recording here")
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as scratch:
        checks = soak(arguments.minutes, arguments.out or Path(scratch))
    table = Table("must hold", "found", "", title=f"soak of {arguments.minutes:g} minutes")
    for check in checks:
        table.add_row(check.what, check.found, "yes" if check.holds else "NO")
    Console().print(table)
    sys.exit(0 if all(check.holds for check in checks) else 1)


if __name__ == "__main__":
    main()
