"""CPUs: who keeps off which, and who keeps them from deep sleep."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from deploy.run.processes.scheduling import leave_loops_their_cpus
from tests.warm_process import cold_python

IDLE_LATENCY_DEVICE = Path("/dev/cpu_dma_latency")
IN_LOCKSTEP = """
import os
import sys
from pathlib import Path
from bus_schema.messages.topics import Role
from deploy.run.processes.scheduling import set_up_scheduling
from deploy.run.processes.status import StatusReporter
from deploy.scenario.scenario import load_setup
setup = load_setup("paper_arm", ["clock=lockstep"])
set_up_scheduling(setup, StatusReporter(Role.PLANT), Role.PLANT)
own = Path("/proc/self/fd")
print(*(os.readlink(own / name) for name in os.listdir(own) if (own / name).is_symlink()))
"""


@pytest.mark.parametrize(
    ("usable", "left"),
    [({0}, {0}), ({2, 5}, {2, 5}), ({0, 1, 2}, {1}), ({3, 0, 9, 4, 1}, {1, 3, 4})],
)
def test_the_first_and_the_last_cpu_are_the_loops(usable, left, monkeypatch):
    taken: list[set[int]] = []
    monkeypatch.setattr(os, "sched_getaffinity", lambda _pid: usable)
    monkeypatch.setattr(os, "sched_setaffinity", lambda _pid, cpus: taken.append(set(cpus)))
    leave_loops_their_cpus()
    assert taken == [left]


@pytest.mark.skipif(
    not os.access(IDLE_LATENCY_DEVICE, os.W_OK), reason=f"{IDLE_LATENCY_DEVICE} may not be written"
)
def test_loops_in_lockstep_keep_cpus_from_deep_sleep_to_their_end() -> None:
    assert str(IDLE_LATENCY_DEVICE) in cold_python("-c", IN_LOCKSTEP).stdout
