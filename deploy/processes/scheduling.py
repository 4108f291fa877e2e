"""How the processes of a run are scheduled: real-time priorities, and CPUs of their own."""

from __future__ import annotations

import os

from bus_schema.messages.topics import Role
from bus_schema.runtime.own_cpu import claim_cpu, none_is_free
from bus_schema.runtime.realtime import RealtimeSetting, go_realtime, use_batch_scheduling
from deploy.processes.lacking import lacking
from deploy.processes.status import StatusReporter
from deploy.scenario.setup import Setup

_BEHIND_OTHERS = 49
"""Priority of a loop without a CPU of its own: loops of other runs that have one go first."""


def set_up_scheduling(setup: Setup, reporter: StatusReporter, role: Role) -> None:
    """Have a loop scheduled as its clock wants it, and report that; before other threads exist."""
    if setup.scenario.clock != "realtime":
        use_batch_scheduling()
        return
    candidates = _cpus_for(setup, role)
    cpu = claim_cpu(candidates)
    if cpu is None and candidates:
        settings = [none_is_free(candidates), *go_realtime(_BEHIND_OTHERS)]
    else:
        settings = go_realtime(cpu=cpu)
    report_settings(settings, reporter)


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
