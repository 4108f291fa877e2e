"""Wake-up lateness as `cyclictest` (rt-tests) measures it: the kernel alone, in C."""

from __future__ import annotations

import re
import shutil
import subprocess
from typing import Any

import numpy as np

from bus_schema.arrays import percentiles

_PRIORITY = 50
_LATEST_US = 20_000
_PATIENCE_S = 30.0
_BUCKET = re.compile(r"^(\d+)\s+(\d+)\s*$", re.MULTILINE)
_OVERFLOWS = re.compile(r"^# Histogram Overflows:\s*(\d+)", re.MULTILINE)


def why_not() -> str | None:
    """Return the reason why `cyclictest` is not available; None if it is."""
    if shutil.which("cyclictest") is None:
        return "cyclictest is not installed (package rt-tests): no comparison of wake-up lateness"
    try:
        run_cyclictest(1000, 0.1)
    except (OSError, ValueError, subprocess.SubprocessError) as error:
        return f"cyclictest does not work here: {error}"
    return None


def run_cyclictest(period_us: int, seconds: float) -> dict[str, Any]:
    """Wake-up lateness in µs, under SCHED_FIFO at the priority of a run's processes.

    Raises:
        OSError, subprocess.SubprocessError: it does not run.
        ValueError: what it printed cannot be read.
    """
    loops = max(1, round(seconds * 1e6 / period_us))
    command = ["cyclictest", "-q", "-m", "-t1", f"-p{_PRIORITY}", f"-i{period_us}", f"-l{loops}",
               f"-h{_LATEST_US}"]  # fmt: skip
    ended = subprocess.run(
        command, capture_output=True, text=True, check=True, timeout=_PATIENCE_S + seconds
    )
    return parse_histogram(ended.stdout)


def parse_histogram(output: str) -> dict[str, Any]:
    """Percentiles of the histogram that ``cyclictest -h`` prints for one thread, in µs.

    Raises:
        ValueError: there is none in it.
    """
    buckets = [(int(late), int(count)) for late, count in _BUCKET.findall(output)]
    overflows = _OVERFLOWS.search(output)
    buckets.append((_LATEST_US, int(overflows[1]) if overflows else 0))
    late_us, counts = np.array(buckets).T
    if not counts.any():
        raise ValueError("it printed no histogram")
    return percentiles(late_us, counts)
