"""Real-time setup of a process, with a report of what the machine granted.

No setting is required for a run: a refusal costs lateness, not correctness. A refusal is reported,
and never an error.
"""

from __future__ import annotations

import contextlib
import ctypes
import gc
import json
import os
import re
import resource
import subprocess
import sys
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass
from pathlib import Path

SCHEDULER = "real-time scheduler"
MEMORY_LOCK = "memory lock"
TIMER_SLACK = "timer slack"
IDLE_STATES = "CPU idle states"
AFFINITY = "CPU affinity"
GARBAGE_COLLECTOR = "garbage collector"
PRECEDENCE = "precedence"

_LIBC = ctypes.CDLL(None, use_errno=True)
_MCL_CURRENT = 1  # <sys/mman.h>
_MCL_FUTURE = 2
_PR_SET_TIMERSLACK = 29  # <linux/prctl.h>
_PR_GET_TIMERSLACK = 30
_PROBE_TIMEOUT_S = 30.0
_STEAL = 8  # the word of the line "cpu" in /proc/stat
_IDLE_LATENCY_DEVICE = Path("/dev/cpu_dma_latency")


@dataclass(frozen=True)
class RealtimeSetting:
    """A real-time setting that was requested, and its outcome.

    Attributes:
        name: the setting.
        granted: whether it is in force.
        detail: what is in force, or why it was refused and how to get it.
    """

    name: str
    granted: bool
    detail: str


_UNTIL_THE_END = contextlib.ExitStack()
"""Holds open files whose settings last as long as the file; the end of the process closes them."""


class _RefusedError(Exception):
    """A request was refused; the message says why and how to get it."""


def go_realtime(priority: int = 50, cpu: int | None = None) -> list[RealtimeSetting]:
    """Set the calling process up for real time; never raise for a refusal.

    Call it in the main thread before other threads exist: Linux keeps scheduler, timer slack and
    affinity per thread, and a thread inherits them from the one that starts it.

    Args:
        priority: SCHED_FIFO priority, 1 to 99.
        cpu: the only CPU to run on; None leaves the choice to the kernel.
    """
    settings = [request_fifo(priority)]
    if cpu is not None:
        settings.append(_attempt(AFFINITY, lambda: _pin(cpu)))
    settings.append(_attempt(MEMORY_LOCK, _lock_memory))
    settings.append(_attempt(TIMER_SLACK, _minimise_timer_slack))
    settings.append(sleep_lightly())
    settings.append(_freeze_garbage_collector())
    return settings


def probe() -> list[RealtimeSetting]:
    """Return what `go_realtime` would be granted; a child process tries it, not the caller."""
    command = [sys.executable, "-P", __file__]
    try:
        child = subprocess.run(
            command, capture_output=True, text=True, timeout=_PROBE_TIMEOUT_S, check=True
        )
        return [RealtimeSetting(**values) for values in json.loads(child.stdout)]
    except (OSError, subprocess.SubprocessError, ValueError) as error:
        names = (SCHEDULER, MEMORY_LOCK, TIMER_SLACK, IDLE_STATES, GARBAGE_COLLECTOR, PRECEDENCE)
        return [RealtimeSetting(name, False, f"could not be tried out: {error}") for name in names]


def request_fifo(priority: int) -> RealtimeSetting:
    """Put the calling thread, and the threads it starts from now on, under SCHED_FIFO.

    Args:
        priority: 1 to 99.
    """
    return _attempt(SCHEDULER, lambda: _schedule(priority))


def raise_priority(nice: int = -10) -> RealtimeSetting:
    """Give the calling thread, and the threads it starts from now on, priority over ordinary ones.

    For a recorder: other programs must not make it fall behind the loops, and it must not delay the
    loops. Call it in the main thread before other threads exist.
    """
    return _attempt(PRECEDENCE, lambda: _precede(nice))


def use_batch_scheduling() -> None:
    """Let running threads finish their work before the calling process handles an arrival.

    For lockstep, where one side waits for the other: a sender that is preempted while sending
    delays both (Linux, sched(7), SCHED_BATCH; needs no permission). Call it in the main thread
    before other threads exist. Without SCHED_BATCH, it does nothing.
    """
    if sys.platform == "linux":
        with contextlib.suppress(OSError):
            os.sched_setscheduler(0, os.SCHED_BATCH, os.sched_param(0))


def sleep_lightly() -> RealtimeSetting:
    """Keep all CPUs out of idle states that take time to leave, until the process ends."""
    return _UNTIL_THE_END.enter_context(light_sleep())


@contextlib.contextmanager
def light_sleep() -> Iterator[RealtimeSetting]:
    """Keep all CPUs out of idle states that take time to leave, while the context lasts.

    An idle CPU then polls. That costs power; in a virtual machine it also keeps the host from
    taking the CPU away at every pause of a loop (Linux, ``admin-guide/pm``, PM QoS).
    """
    with contextlib.ExitStack() as stack:
        yield _attempt(IDLE_STATES, lambda: _stay_awake(stack))


def stolen_ms() -> float:
    """Return the CPU time that the hypervisor took from CPUs with work, since boot, ms.

    The sum over all CPUs, in steps of about 10 ms; 0 where the kernel reports none (proc(5),
    steal).
    """
    try:
        totals = Path("/proc/stat").read_text().splitlines()[0].split()
    except OSError:
        return 0.0
    return 1e3 * float(totals[_STEAL]) / os.sysconf("SC_CLK_TCK")


def _attempt(name: str, apply: Callable[[], str]) -> RealtimeSetting:
    if sys.platform != "linux":
        return RealtimeSetting(name, False, f"set up on Linux only, not on {sys.platform}")
    try:
        return RealtimeSetting(name, True, apply())
    except (_RefusedError, OSError, ValueError, OverflowError) as error:
        return RealtimeSetting(name, False, str(error))


def _schedule(priority: int) -> str:
    limit = _raised_limit(resource.RLIMIT_RTPRIO)
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(priority))
    except PermissionError as error:
        raise _RefusedError(
            f"SCHED_FIFO {priority} is not permitted (rtprio limit {limit}): allow it by rtprio "
            f"{priority} in /etc/security/limits.conf, LimitRTPRIO={priority} in a systemd unit "
            "or the capability CAP_SYS_NICE"
        ) from error
    except OSError as error:
        raise _RefusedError(
            f"SCHED_FIFO {priority}: {error.strerror}; priorities are 1 to 99"
        ) from error
    return f"SCHED_FIFO, priority {priority}"


def _precede(nice: int) -> str:
    try:
        os.setpriority(os.PRIO_PROCESS, 0, nice)
    except PermissionError as error:
        raise _RefusedError(
            f"nice {nice} is not permitted: allow it by nice {nice} in /etc/security/limits.conf, "
            f"Nice={nice} in a systemd unit or the capability CAP_SYS_NICE"
        ) from error
    return f"nice {nice}"


def _pin(cpu: int) -> str:
    usable = sorted(os.sched_getaffinity(0))
    if cpu not in usable:
        raise _RefusedError(f"CPU {cpu} cannot be used; usable are {usable}")
    os.sched_setaffinity(0, {cpu})
    return f"CPU {cpu}"


def _lock_memory() -> str:
    limit = _raised_limit(resource.RLIMIT_MEMLOCK)
    # Under a finite limit mlockall may well succeed, and the first allocation beyond the limit
    # then fail in the middle of the run.
    if limit != resource.RLIM_INFINITY and not _exempt_from_memlock_limit():
        raise _RefusedError(
            f"memlock limit is {limit // 1024} KiB, and later allocations would fail on it: allow "
            "memlock unlimited in /etc/security/limits.conf, LimitMEMLOCK=infinity in a systemd "
            "unit or the capability CAP_IPC_LOCK"
        )
    # The first is address space of this process that has no memory behind it yet.
    needed = _kib("/proc/self/status", "VmSize") - _kib("/proc/self/status", "VmRSS")
    available = _kib("/proc/meminfo", "MemAvailable")
    if needed > available:
        raise _RefusedError(
            f"locking would claim {needed // 1024} MiB more, {available // 1024} MiB are available"
        )
    if _LIBC.mlockall(_MCL_CURRENT | _MCL_FUTURE) != 0:
        raise _RefusedError(f"mlockall: {os.strerror(ctypes.get_errno())}")
    return "current and future pages"


def _minimise_timer_slack() -> str:
    unused = [ctypes.c_ulong(0)] * 3
    if _LIBC.prctl(_PR_SET_TIMERSLACK, ctypes.c_ulong(1), *unused) != 0:
        raise _RefusedError(f"prctl: {os.strerror(ctypes.get_errno())}")
    slack_ns = _LIBC.prctl(_PR_GET_TIMERSLACK, ctypes.c_ulong(0), *unused)
    return f"{slack_ns} ns"  # the kernel keeps 0 for a thread under SCHED_FIFO


def _stay_awake(stack: contextlib.ExitStack) -> str:
    try:
        request = stack.enter_context(_IDLE_LATENCY_DEVICE.open("r+b", buffering=0))
    except FileNotFoundError as error:
        raise _RefusedError(
            f"{_IDLE_LATENCY_DEVICE} does not exist, or a sandbox hides it"
        ) from error
    except PermissionError as error:
        raise _RefusedError(
            f"{_IDLE_LATENCY_DEVICE} may not be written: allow it by a udev rule, such as "
            'KERNEL=="cpu_dma_latency", GROUP="realtime", MODE="0660"'
        ) from error
    request.write((0).to_bytes(4, sys.byteorder))
    in_force_us = int.from_bytes(request.read(4) or b"", sys.byteorder)
    return f"left within {in_force_us} µs"


def _freeze_garbage_collector() -> RealtimeSetting:
    gc.collect()
    gc.freeze()
    gc.disable()
    return RealtimeSetting(
        GARBAGE_COLLECTOR, True, f"off, {gc.get_freeze_count()} objects set aside"
    )


def _raised_limit(limit: int) -> int:
    """Raise the soft limit to the hard one, which needs no privilege, and return it."""
    hard = resource.getrlimit(limit)[1]
    resource.setrlimit(limit, (hard, hard))
    return hard


def _exempt_from_memlock_limit() -> bool:
    """Whether one page can be locked under a limit of zero.

    The set of capabilities does not show it: inside a user namespace it may hold CAP_IPC_LOCK, but
    the kernel checks the initial namespace.
    """
    page = ctypes.create_string_buffer(1)
    soft, hard = resource.getrlimit(resource.RLIMIT_MEMLOCK)
    resource.setrlimit(resource.RLIMIT_MEMLOCK, (0, hard))
    try:
        locked: bool = _LIBC.mlock(page, ctypes.c_size_t(1)) == 0
    finally:
        resource.setrlimit(resource.RLIMIT_MEMLOCK, (soft, hard))
    if locked:
        _LIBC.munlock(page, ctypes.c_size_t(1))
    return locked


def _kib(file: str, key: str) -> int:
    found = re.search(rf"^{key}:\s+(\d+) kB", Path(file).read_text(), re.MULTILINE)
    return int(found[1]) if found else 0


if __name__ == "__main__":
    print(json.dumps([asdict(setting) for setting in (*go_realtime(), raise_priority())]))
