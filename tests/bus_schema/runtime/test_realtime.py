from __future__ import annotations

import gc
import json
import os
import resource
import subprocess
import sys
import textwrap
from pathlib import Path
from typing import Any

import pytest

from bus_schema.runtime import realtime

REPOSITORY = Path(realtime.__file__).resolve().parents[2]
PRELUDE = """
import gc, json, mmap, os, resource, threading
from pathlib import Path
from bus_schema.runtime import realtime

def drop_privileges(memlock_bytes):
    hard = resource.getrlimit(resource.RLIMIT_MEMLOCK)[1]
    if hard != resource.RLIM_INFINITY:
        memlock_bytes = min(memlock_bytes, hard)
    resource.setrlimit(resource.RLIMIT_MEMLOCK, (memlock_bytes, memlock_bytes))
    resource.setrlimit(resource.RLIMIT_RTPRIO, (0, 0))
    if os.getuid() == 0:
        os.setgroups([])
        os.setgid(65534)
        os.setuid(65534)

def locked_kib():
    status = Path("/proc/self/status").read_text()
    return int(status.split("VmLck:")[1].split()[0])

def report(grants, **facts):
    granted = {grant.name: [grant.granted, grant.detail] for grant in grants}
    print(json.dumps({"grants": granted, "scheduler": os.sched_getscheduler(0),
                      "locked_kib": locked_kib(), **facts}))
"""


def in_child(script: str) -> dict[str, Any]:
    child = subprocess.run(
        [sys.executable, "-c", PRELUDE + textwrap.dedent(script)],
        capture_output=True, text=True, cwd=REPOSITORY, check=False,
    )  # fmt: skip
    assert child.returncode == 0, child.stderr
    result: dict[str, Any] = json.loads(child.stdout)
    return result


def own_state() -> dict[str, Any]:
    status = Path("/proc/self/status").read_text()
    return {
        "scheduler": os.sched_getscheduler(0),
        "priority": os.sched_getparam(0).sched_priority,
        "affinity": os.sched_getaffinity(0),
        "locked": status.split("VmLck:")[1].split()[0],
        "slack": Path("/proc/self/timerslack_ns").read_text(),
        "limits": [
            resource.getrlimit(limit) for limit in (resource.RLIMIT_RTPRIO, resource.RLIMIT_MEMLOCK)
        ],
        "gc": (gc.isenabled(), gc.get_freeze_count()),
    }


def test_grants_report_the_settings_in_force() -> None:
    result = in_child("""
        cpu = max(os.sched_getaffinity(0))
        grants = realtime.go_realtime(priority=7, cpu=cpu)
        report(grants, cpu=cpu, priority=os.sched_getparam(0).sched_priority,
               affinity=sorted(os.sched_getaffinity(0)),
               slack_ns=int(Path("/proc/self/timerslack_ns").read_text()),
               collecting=gc.isenabled(), frozen=gc.get_freeze_count())
    """)
    granted = {name: value for name, (value, _) in result["grants"].items()}
    assert granted[realtime.SCHEDULER] == (result["scheduler"] == os.SCHED_FIFO)
    assert granted[realtime.SCHEDULER] == (result["priority"] == 7)
    assert granted[realtime.MEMORY_LOCK] == (result["locked_kib"] > 0)
    assert granted[realtime.TIMER_SLACK] == (result["slack_ns"] <= 1)
    assert granted[realtime.AFFINITY] == (result["affinity"] == [result["cpu"]])
    assert granted[realtime.GARBAGE_COLLECTOR]
    assert not result["collecting"]
    assert result["frozen"] > 0


def test_disabled_preemption_holds_in_later_threads() -> None:
    result = in_child("""
        realtime.use_batch_scheduling()
        seen = []
        thread = threading.Thread(target=lambda: seen.append(os.sched_getscheduler(0)))
        thread.start()
        thread.join()
        report([], thread=seen[0])
    """)
    assert result["scheduler"] == result["thread"] == os.SCHED_BATCH


@pytest.mark.parametrize("memlock_bytes", [64 << 10, 1 << 30])
def test_refused_permissions_are_reported_with_the_reason(memlock_bytes: int) -> None:
    result = in_child(f"""
        drop_privileges({memlock_bytes})
        report(realtime.go_realtime(), allocated=len(mmap.mmap(-1, 2 << 30)))
    """)
    granted, detail = result["grants"][realtime.SCHEDULER]
    assert not granted
    assert "rtprio limit 0" in detail
    assert "CAP_SYS_NICE" in detail
    assert result["scheduler"] == os.SCHED_OTHER
    # Even where a finite limit would let the lock itself succeed: allocations must not fail later.
    granted, detail = result["grants"][realtime.MEMORY_LOCK]
    assert not granted
    assert "memlock limit" in detail
    assert result["locked_kib"] == 0
    assert result["allocated"] == 2 << 30
    assert result["grants"][realtime.TIMER_SLACK][0]


def test_precedence_is_granted_or_refused_with_what_would_change_that() -> None:
    result = in_child("""
        report([realtime.raise_priority(-3)], nice=os.getpriority(os.PRIO_PROCESS, 0))
    """)
    granted, detail = result["grants"][realtime.PRECEDENCE]
    assert granted == (result["nice"] == -3)
    assert "nice -3" in detail
    refused = in_child("""
        drop_privileges(1 << 30)
        report([realtime.raise_priority()], nice=os.getpriority(os.PRIO_PROCESS, 0))
    """)
    granted, detail = refused["grants"][realtime.PRECEDENCE]
    assert not granted
    assert "CAP_SYS_NICE" in detail
    assert refused["nice"] == os.getpriority(os.PRIO_PROCESS, 0)


def test_cpus_sleep_lightly_while_the_grant_lasts_and_no_longer() -> None:
    result = in_child("""
        device = Path("/dev/cpu_dma_latency")

        def requests():
            links = [file for file in Path("/proc/self/fd").iterdir() if file.is_symlink()]
            return sum(file.readlink() == device for file in links)

        def allowed_us():
            with device.open("rb", buffering=0) as request:
                return int.from_bytes(request.read(4), "little")

        with realtime.light_sleep() as grant:
            inside = [requests(), allowed_us() if grant.granted else 0]
        outside = requests()
        grants = realtime.go_realtime()
        kept = [requests(), allowed_us() if grant.granted else 0]
        report([*grants, grant], inside=inside, outside=outside, kept=kept)
    """)
    granted, detail = result["grants"][realtime.IDLE_STATES]
    # The request is in force while the process has the device open.
    assert result["inside"] == result["kept"] == [int(granted), 0]
    assert result["outside"] == 0
    assert detail == "left within 0 µs" if granted else "cpu_dma_latency" in detail


def test_memory_is_not_locked_where_locking_would_exhaust_it() -> None:
    result = in_child("""
        realtime._kib = lambda _, key: 0 if key in ("MemAvailable", "VmRSS") else 1
        report(realtime.go_realtime())
    """)
    assert not result["grants"][realtime.MEMORY_LOCK][0]
    assert result["locked_kib"] == 0


@pytest.mark.parametrize("priority", [-1, 0, 100, 1 << 40])
def test_an_impossible_priority_is_refused_with_a_reason(priority: int) -> None:
    result = in_child(f"report([realtime.request_fifo({priority})])")
    granted, detail = result["grants"][realtime.SCHEDULER]
    assert not granted
    assert detail
    assert result["scheduler"] == os.SCHED_OTHER


@pytest.mark.parametrize("cpu", [-1, 1_000_000])
def test_a_cpu_that_is_not_there_is_refused_with_those_that_are(cpu: int) -> None:
    result = in_child(f"report(realtime.go_realtime(cpu={cpu}))")
    granted, detail = result["grants"][realtime.AFFINITY]
    assert not granted
    assert str(sorted(os.sched_getaffinity(0))) in detail


def test_probe_leaves_the_caller_as_it_is() -> None:
    before = own_state()
    grants = realtime.probe()
    assert own_state() == before
    assert [grant.name for grant in grants] == [
        realtime.SCHEDULER,
        realtime.MEMORY_LOCK,
        realtime.TIMER_SLACK,
        realtime.IDLE_STATES,
        realtime.GARBAGE_COLLECTOR,
        realtime.PRECEDENCE,
    ]


def test_probe_foretells_what_go_realtime_is_granted() -> None:
    result = in_child("""
        foretold = {grant.name: grant.granted for grant in realtime.probe()}
        report([*realtime.go_realtime(), realtime.raise_priority()], foretold=foretold)
    """)
    granted = {name: value for name, (value, _) in result["grants"].items()}
    assert result["foretold"] == granted
