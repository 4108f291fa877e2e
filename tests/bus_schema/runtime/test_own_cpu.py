"""No two processes have the same CPU for their loops, and a killed one gives its own back."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from bus_schema.runtime import own_cpu

ROOT = Path(own_cpu.__file__).resolve().parents[2]
FICTITIOUS = (70_001, 70_002)
CLAIM = f"""
from bus_schema.runtime.own_cpu import claim_cpu
print(claim_cpu({FICTITIOUS}), flush=True)
input()
"""


@contextmanager
def claimant() -> Iterator[tuple[subprocess.Popen[str], str]]:
    """A process that has claimed one of the CPUs, and what it got."""
    with subprocess.Popen(
        [sys.executable, "-c", CLAIM], cwd=ROOT, text=True,
        stdin=subprocess.PIPE, stdout=subprocess.PIPE,
    ) as process:  # fmt: skip
        assert process.stdout is not None
        try:
            yield process, process.stdout.readline().strip()
        finally:
            process.kill()


def test_each_process_gets_a_cpu_of_its_own_and_the_third_none() -> None:
    with claimant() as (first, got_first), claimant() as (_, got_second):
        assert (got_first, got_second) == ("70001", "70002")
        with claimant() as (_, got_third):
            assert got_third == "None"
        first.kill()
        first.wait()
        with claimant() as (_, got_fourth):
            assert got_fourth == "70001"
