"""What tests of several packages share."""

from __future__ import annotations

import atexit
import gc
import os
import signal
import subprocess
from collections.abc import Iterator
from pathlib import Path

import hypothesis
import pytest

from deploy.run.stop_signals import STOPS, stop_at_once

# On a new machine any test may be the first to need a kernel: what it reads stays the same.
os.environ["FUNNEL_HIL_HAS_SAID_THAT_IT_COMPILES"] = "1"

# Matrices here are small: threads of a BLAS that wait for each other beside other tests took six
# times as long. NumPy and SciPy read it when a test first imports them, processes inherit it.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

# What is printed depends on the terminal, which tests describe themselves.
os.environ["TERM"] = "xterm"
for variable in ("COLUMNS", "LINES", "NO_COLOR", "FORCE_COLOR", "TTY_COMPATIBLE"):
    os.environ.pop(variable, None)

# A build is to judge the change, not the luck of the draw; and its machine may be slow.
hypothesis.settings.register_profile("repeatable", derandomize=True, deadline=None)
hypothesis.settings.load_profile("repeatable")

# The libraries are a million objects that live to the end: the collector need not visit them.
gc.set_threshold(20_000)
atexit.register(gc.freeze)


def pytest_collection_finish() -> None:
    gc.collect()
    gc.freeze()


@pytest.fixture
def heeded_signals() -> Iterator[None]:
    """Requests to stop do what they do by default, SIGHUP under nohup too; then as before."""
    before = {number: signal.getsignal(number) for number in STOPS}
    for number in STOPS:
        signal.signal(number, signal.default_int_handler)
    yield
    stop_at_once()  # forgets the requests of this test
    for number, handler in before.items():
        signal.signal(number, handler)


@pytest.fixture
def small_disk(tmp_path: Path) -> Iterator[Path]:
    """A file system of half a megabyte."""
    path = tmp_path / "small_disk"
    path.mkdir()
    words = ["mount", "-t", "tmpfs", "-o", "size=512k", "tmpfs", str(path)]
    mounted = subprocess.run(words, capture_output=True, text=True, check=False)
    if mounted.returncode:
        pytest.skip(f"a small disk needs the right to mount one: {mounted.stderr.strip()}")
    yield path
    subprocess.run(["umount", "--lazy", str(path)], check=True)
