"""Signals at random instants to random processes of runs: what they leave, and how runs end.

`python -m scripts.benchmarks.signals [--times 60] [--seed 1]`: runs in real time and in lockstep by
turns. Of each: does everything end, is nothing left in TMPDIR, does the exit code say what
happened, does the recording open, and is no run called kept that was disturbed?
"""

from __future__ import annotations

import argparse
import json
import os
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import NamedTuple

import numpy as np
from rich.console import Console

from bus_schema.messages.run_event import EventKind
from bus_schema.messages.topics import Role
from deploy.run.network.links import free_ports
from deploy.run.run_folder import load_run
from scripts.benchmarks.leftovers import processes_with

_MARK = "FUNNEL_HIL_SIGNALS"
_SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGKILL, signal.SIGSTOP)
_LATEST_S = 9.0
_FROZEN_S = 2.0
_ENDS_WITHIN_S = 180.0
_DURATION_S = {"realtime": 4, "lockstep": 20}


class Case(NamedTuple):
    """One run, and the signal that disturbs it.

    Attributes:
        at_s: seconds after the command was started.
        draw: between 0 and 1: which of the processes then alive.
    """

    clock: str
    number: signal.Signals
    at_s: float
    draw: float


def cases(times: int, seed: int) -> list[Case]:
    """So many cases; the same ones for the same seed."""
    random = np.random.default_rng(seed)
    return [
        Case(
            ("realtime", "lockstep")[index % 2],
            _SIGNALS[int(random.integers(len(_SIGNALS)))],
            float(random.uniform(0.02, _LATEST_S)),
            float(random.random()),
        )
        for index in range(times)
    ]


def disturb(case: Case, folder: Path) -> tuple[str, list[str]]:
    """Do one case below a folder; what was hit, and a line for all that is wrong."""
    temporary, result = folder / "tmp", folder / "run"
    temporary.mkdir(parents=True)
    mark = f"{_MARK}={folder}"
    plant, controller = free_ports(2)
    values = (
        f"clock={case.clock}", f"duration_s={_DURATION_S[case.clock]}",
        f"link.plant_endpoint=tcp/127.0.0.1:{plant}",
        f"link.controller_endpoint=tcp/127.0.0.1:{controller}",
    )  # fmt: skip
    words = [word for value in values for word in ("--set", value)]
    command = subprocess.Popen(
        [sys.executable, "-m", "deploy.cli", "run", "paper_arm", "--out", str(result), *words],
        env={**os.environ, "TMPDIR": str(temporary), _MARK: str(folder)},
        stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True, start_new_session=True,
    )  # fmt: skip
    time.sleep(case.at_s)
    hit = _hit(case, mark)
    try:
        output = command.communicate(timeout=_ENDS_WITHIN_S)[1]
    except subprocess.TimeoutExpired:
        command.kill()
        output = command.communicate()[1]
        return hit, [f"did not end within {_ENDS_WITHIN_S:g} s"]
    wrong = _left(mark, temporary) + _told(command.returncode, hit, result)
    if "Traceback" in output or "Exception ignored" in output:
        wrong.append(f"traceback: {output[-300:]}")
    return hit, wrong


def _hit(case: Case, mark: str) -> str:
    """Send the signal to one of a run's processes; which one it was, or nothing."""
    members = sorted(processes_with(mark), key=lambda line: int(line.split()[0]))
    if not members:
        return ""
    chosen = members[int(case.draw * len(members))]
    pid = int(chosen.split()[0])
    try:
        os.kill(pid, case.number)
        if case.number == signal.SIGSTOP:
            time.sleep(_FROZEN_S)
            os.kill(pid, signal.SIGCONT)
    except ProcessLookupError:
        return ""
    return _name(chosen)


def _name(line: str) -> str:
    """Return the role of a process, from its command line."""
    for word in (
        "fork_server",
        " plant ",
        " controller ",
        " recorder ",
        " run ",
    ):
        if word in line:
            return word.strip()
    return line


def _left(mark: str, temporary: Path) -> list[str]:
    """Processes and files that are still there after a while."""
    give_up_s = time.monotonic() + 15.0
    while True:
        left = [f"process {line}" for line in processes_with(mark)]
        left += [f"file {entry.name}" for entry in temporary.iterdir()]
        if not left or time.monotonic() > give_up_s:
            return left
        time.sleep(0.1)


def _told(code: int, hit: str, result: Path) -> list[str]:
    """Return the contradictions between exit code, recording and verdict."""
    wrong = [] if code in (0, 1, 130, -signal.SIGKILL) else [f"exit code {code}"]
    if hit == "run" and code == -signal.SIGTERM:  # before Python has begun, no handler is there
        wrong.clear()
    summary = result / "summary.json"
    verdict = json.loads(summary.read_text())["verdict"] if summary.exists() else None
    # A request to stop may come after the end of the run, while its report is drawn.
    if (code == 0) > (verdict in ("kept", "lost")) or (code == 1 and verdict == "kept"):
        wrong.append(f"exit code {code}, verdict {verdict}")
    if (result / "run.mcap").exists():
        data, _ = load_run(result)
        if code == 0 and not data.last_values(Role.PLANT, EventKind.ENDED):
            wrong.append("exit code 0 without the plant's end in the recording")
    return wrong


def main() -> None:
    """Do the cases, and show what is wrong with any; exit code 1 if anything is."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--times", type=int, default=60)
    parser.add_argument("--seed", type=int, default=1)
    options = parser.parse_args()
    console, failed = Console(), 0
    for index, case in enumerate(cases(options.times, options.seed)):
        with tempfile.TemporaryDirectory() as folder:
            hit, wrong = disturb(case, Path(folder))
        failed += bool(wrong)
        what = f"{case.number.name} to {hit or 'nothing'} at {case.at_s:.2f} s, {case.clock}"
        console.print(f"{index:3} {what}: {'; '.join(wrong) or 'in order'}", soft_wrap=True)
    console.print(f"{options.times} signals, {failed} runs with something wrong")
    sys.exit(bool(failed))


if __name__ == "__main__":
    main()
