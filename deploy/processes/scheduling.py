"""How the processes of a run are scheduled: real-time priorities, and CPUs of their own."""

from __future__ import annotations

import contextlib
import os
import sys

from bus_schema.messages.topics import Role
from bus_schema.runtime.own_cpu import claim_cpu, none_is_free
from bus_schema.runtime.realtime import (
    RealtimeSetting,
    go_realtime,
    sleep_lightly,
    use_batch_scheduling,
)
from deploy.processes.lacking import lacking
from deploy.processes.status import StatusReporter
from deploy.scenario.setup import Setup

_BEHIND_OTHERS = 49
"""Priority of a loop without a CPU of its own: loops of other runs that have one go first."""


def set_up_scheduling(setup: Setup, reporter: StatusReporter, role: Role) -> bool:
    """Have a loop scheduled as its clock wants it, and report that; before other threads exist.

    Returns:
        whether it has a CPU that no other real-time loop runs on.
    """
    if setup.scenario.clock != "realtime":
        use_batch_scheduling()
        # Each waits for the other at every tick; to wake up a CPU would be half of that. It is no
        # matter of deadlines: where it is refused, the run takes longer.
        sleep_lightly()
        return False
    candidates = _cpus_for(setup, role)
    cpu = claim_cpu(candidates)
    if cpu is None and candidates:
        settings = [none_is_free(candidates), *go_realtime(_BEHIND_OTHERS)]
    else:
        settings = go_realtime(cpu=cpu)
    report_settings(settings, reporter)
    return cpu is not None


def leave_loops_their_cpus() -> None:
    """Keep the calling process off the CPUs that loops are given first, where there are others.

    For whoever works beside a run: recorder and live view. To be called before other threads exist.
    """
    if sys.platform == "linux":
        usable = sorted(os.sched_getaffinity(0))
        with contextlib.suppress(OSError):
            os.sched_setaffinity(0, usable[1:-1] or usable)


def report_settings(settings: list[RealtimeSetting], reporter: StatusReporter) -> None:
    """Report what was asked of the system, and what the lack of it costs."""
    told = [vars(setting) for setting in settings]
    reporter.report("realtime", settings=told)
    if text := lacking(told):
        reporter.report("lacks", text=text)


def _cpus_for(setup: Setup, role: Role) -> list[int]:
    """The usable CPUs, the best for a loop first: the last for the plant, as it owns the clock and
    the first often has the interrupts. None for no choice: where there is but one, or where the
    link has threads that need the others.
    """
    usable = sorted(os.sched_getaffinity(0))
    if len(usable) == 1 or not setup.link_kind.may_pin_loops:
        return []
    return usable[::-1] if role is Role.PLANT else usable
