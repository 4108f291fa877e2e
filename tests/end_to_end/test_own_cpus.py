"""Two runs in real time on one machine: the second says that no CPU is left for its loops."""

from __future__ import annotations

import json
import os
import time
from pathlib import Path

import pytest
from running import funnel_hil_here, settings

from bus_schema.runtime.own_cpu import claim_cpu
from bus_schema.runtime.realtime import AFFINITY

PATIENCE_S = 60.0
USABLE = sorted(os.sched_getaffinity(0))


@pytest.mark.skipif(len(USABLE) == 1, reason="loops are bound to no CPU where there is but one")
def test_a_run_that_finds_all_cpus_taken_binds_no_loop_and_says_so(tmp_path: Path) -> None:
    claimed, give_up_s = 0, time.monotonic() + PATIENCE_S
    while claimed < len(USABLE):
        if claim_cpu(USABLE) is not None:
            claimed += 1
        elif time.monotonic() > give_up_s:
            pytest.skip("another run on this machine keeps a CPU of its own")
        else:
            time.sleep(0.1)
    run = funnel_hil_here(
        "run", "paper_arm", *settings(clock="realtime", duration_s=0.2), out=tmp_path / "run"
    )
    realtime = json.loads((tmp_path / "run" / "manifest.json").read_text())["realtime"]
    for role in ("plant", "controller"):
        affinity = next(one for one in realtime[role] if one["name"] == AFFINITY)
        assert not affinity["granted"]
    assert "CPU affinity" in run.output
    assert "each of the CPUs" in run.output
