"""Scheduling of a run's processes: real-time priorities, CPUs, and refused settings."""

from __future__ import annotations

import contextlib
import getpass
import os
import sys
from collections.abc import Iterable, Mapping
from typing import Any

from bus_schema.messages.topics import Role
from bus_schema.runtime.own_cpu import claim_cpu, none_is_free
from bus_schema.runtime.realtime import (
    AFFINITY,
    IDLE_STATES,
    MEMORY_LOCK,
    PRECEDENCE,
    SCHEDULER,
    RealtimeSetting,
    go_realtime,
    sleep_lightly,
    use_batch_scheduling,
)
from deploy.run.processes.status import StatusReporter
from deploy.scenario.setup import Setup

_BEHIND_OTHERS = 49
"""Priority of a loop without its own CPU, below that of other runs' loops with one."""

_REMEDIED = (SCHEDULER, MEMORY_LOCK, IDLE_STATES, PRECEDENCE)
_GROUP = "realtime"


def set_up_scheduling(setup: Setup, reporter: StatusReporter, role: Role) -> bool:
    """Schedule a loop by its clock, and report the settings; call it before other threads exist.

    Returns:
        whether it has a CPU without another real-time loop.
    """
    if setup.scenario.clock != "realtime":
        use_batch_scheduling()
        # Each waits for the other at every tick, and waking an idle CPU would take half of that
        # time. It does not affect deadlines: if it is refused, the run only takes longer.
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
    """Keep the calling process off the CPUs that loops get first, if there are others.

    For processes beside the loops: recorder and live view. Call it before other threads exist.
    """
    if sys.platform == "linux":
        usable = sorted(os.sched_getaffinity(0))
        with contextlib.suppress(OSError):
            os.sched_setaffinity(0, usable[1:-1] or usable)


def report_settings(settings: list[RealtimeSetting], reporter: StatusReporter) -> None:
    """Report the settings requested from the system, and the cost of those that are missing."""
    shown = [vars(setting) for setting in settings]
    reporter.report("realtime", settings=shown)
    if text := missing_settings(shown):
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


def missing_settings(settings: Iterable[Mapping[str, Any]]) -> str:
    """Describe refused settings in one line; empty if none was.

    Args:
        settings: fields of `RealtimeSetting`, from one process or several.
    """
    refused = [setting for setting in settings if not setting["granted"]]
    names = dict.fromkeys(setting["name"] for setting in refused)
    if not names:
        return ""
    own = {setting["detail"] for setting in refused if setting["name"] == AFFINITY}
    details = "".join(f" ({detail})" for detail in sorted(own))
    sentence = f"works without {', '.join(names)}{details}"
    if names.keys() & set(_REMEDIED):
        sentence += ": more deadlines may be missed; funnel-hil doctor --fix shows how to allow it"
    return sentence


def remedy() -> str:
    """Return commands that allow real-time runs to the user; they are only shown."""
    try:
        user = getpass.getuser()
    except (KeyError, OSError):  # a container's user without an entry in /etc/passwd
        user = str(os.getuid())
    return f"""\
# Allows real-time runs to {user}, once and for all. To be run as root; then log in again.
groupadd --force {_GROUP}
usermod --append --groups {_GROUP} {user}
cat >/etc/security/limits.d/99-{_GROUP}.conf <<'END'
@{_GROUP} - rtprio 50
@{_GROUP} - memlock unlimited
@{_GROUP} - nice -10
END
cat >/etc/udev/rules.d/99-{_GROUP}.rules <<'END'
KERNEL=="cpu_dma_latency", GROUP="{_GROUP}", MODE="0660"
END
udevadm control --reload-rules && udevadm trigger --name-match=cpu_dma_latency"""
