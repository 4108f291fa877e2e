"""A process that was started by another one leaves with it."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[3]
HANG_S = 60
CHILD = """
import os, signal, sys, time
from deploy.processes.parent import end_with_parent

def leave(number, frame):
    print("leaves in order", flush=True)
    sys.exit(0)

end_with_parent(int(sys.argv[1]))
signal.signal(signal.SIGTERM, leave)
signal.signal(signal.SIGUSR1, lambda number, frame: print("is there", flush=True))
print("waits", flush=True)
while True:
    time.sleep(0.01)
"""
PARENT = """
import os, subprocess, sys
child = subprocess.Popen([sys.executable, "-c", sys.argv[1], str(os.getpid())])
print(child.pid, flush=True)
child.wait()
"""


@pytest.mark.parametrize("is_stopped", [False, True], ids=["running", "stopped"])
def test_child_leaves_in_order_when_its_parent_is_killed(is_stopped: bool) -> None:
    parent = subprocess.Popen(
        [sys.executable, "-c", PARENT, CHILD], cwd=ROOT, stdout=subprocess.PIPE, text=True
    )
    assert parent.stdout is not None
    child = int(parent.stdout.readline())
    assert parent.stdout.readline() == "waits\n"
    if is_stopped:
        os.kill(child, signal.SIGSTOP)
    try:
        parent.kill()
        # The pipe ends when the last process that holds it is gone.
        said, _ = parent.communicate(timeout=HANG_S)
    except subprocess.TimeoutExpired:
        os.kill(child, signal.SIGKILL)
        raise
    assert said == "leaves in order\n"


def test_child_goes_on_after_a_pause_while_its_parent_is_there() -> None:
    with subprocess.Popen(
        [sys.executable, "-c", CHILD, str(os.getpid())],
        cwd=ROOT, stdout=subprocess.PIPE, text=True,
    ) as child:  # fmt: skip
        assert child.stdout is not None
        assert child.stdout.readline() == "waits\n"
        child.send_signal(signal.SIGSTOP)
        child.send_signal(signal.SIGCONT)
        for _ in range(3):  # by the second time it has long taken notice of the pause
            child.send_signal(signal.SIGUSR1)
            assert child.stdout.readline() == "is there\n"
        child.terminate()


def test_child_whose_parent_was_gone_before_it_could_ask_ends_at_once() -> None:
    ended = subprocess.run(
        [sys.executable, "-c", CHILD, "1"],
        cwd=ROOT, capture_output=True, text=True, timeout=HANG_S, check=False,
    )  # fmt: skip
    assert ended.returncode == -signal.SIGTERM
    assert ended.stdout == ""
