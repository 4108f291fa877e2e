"""Sentences on the host of a run in real time, apart from those on the law."""

from __future__ import annotations

import re
import shlex
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from bus_schema.messages.topics import Role
from bus_schema.runtime.realtime import AFFINITY, SCHEDULER
from controller.law_choice import is_program
from deploy.judge.conditions import lacked_grants
from deploy.judge.findings.stalls import STALL_MS
from deploy.judge.metrics import RunResult
from deploy.judge.recorded_ticks import known_ticks
from deploy.judge.run_data import ROBOT_SERVER
from deploy.reports.tables import number
from deploy.run.run_folder import RunFolder
from deploy.scenario.setup import Setup

if TYPE_CHECKING:
    from deploy.run.execute import JudgedRun

_CONTROLLER_ENDED = re.compile(f"the {Role.CONTROLLER} (was|ended|failed)")
"""A failure of its process during the run."""
_GOES_FIRST = {SCHEDULER: "other programs", AFFINITY: "another loop on its CPU"}
"""Who holds up a loop that lacks a setting."""


def sentences_on_the_host(judged: JudgedRun, manifest: Mapping[str, Any]) -> list[str]:
    """Return what kept a run from real time, and the command that repeats it without the host.

    Nothing for a run in virtual time, or one that met all its deadlines without a long stall.
    """
    timing = judged.result.timing
    if judged.data.clock != "realtime":
        return []
    stalled = _sentences_on_a_stall(timing.longest_stall_ms, manifest)
    if not (misses := timing.late_ticks):
        return stalled
    ticks, skipped = known_ticks(judged.data).known, misses > timing.deadline_misses
    in_a_row = timing.late_longest_run
    longest_ms = in_a_row * judged.data.setup.grid.period_ns * 1e-6
    stolen_ms = timing.stolen_ms
    stolen = f"; a hypervisor took {stolen_ms:.0f} ms of CPU time away" if stolen_ms else ""
    missed = (
        f"{misses:,} of {ticks:,} ticks"
        f" ({number(misses / ticks, 100)} %) {'were skipped or ' * skipped}missed their deadline,"
        f" at most {in_a_row:,} in a row ({number(longest_ms)} ms)"
    )
    if ended := [each for each in judged.data.failures if _CONTROLLER_ENDED.match(each)]:
        return [f"{missed}, as the controller process ended: {ended[0]}.", *stalled]
    late = f"{_who_was_late(judged)} late: {missed}{stolen}."
    return [late, *stalled, *_repetition(judged, manifest)]


def _who_was_late(judged: JudgedRun) -> str:
    """Name everything that can have caused the misses; the host always can."""
    setup, result = judged.data.setup, judged.result
    step_us = result.timing.control_step_us["p50"]
    is_slow = step_us is None or step_us * 1e3 > setup.grid.period_ns
    causes = ["the host"]
    if is_program(setup.scenario.controller.name) or is_slow:
        causes.append("the controller")
    if not _link_is_steady(setup, result):
        causes.append("the emulated link")
    if setup.scenario.faults:
        causes.append("a fault")
    return f"{' or '.join(causes).capitalize()} was"


def _link_is_steady(setup: Setup, result: RunResult) -> bool:
    """Whether each message of the emulated link takes the same time, within the deadline."""
    delays = [way.delay_ms or {} for way in (result.transport.uplink, result.transport.downlink)]
    lost = result.transport.uplink.lost or result.transport.downlink.lost
    is_even = not lost and all(delay.get("mean") == delay.get("max") for delay in delays)
    link = setup.scenario.link
    needed_ns = setup.grid.period_ns + link.emulated_round_trip_ns
    return is_even and link.deadline_ns(0, needed_ns) >= needed_ns


def _repetition(judged: JudgedRun, manifest: Mapping[str, Any]) -> list[str]:
    """Name the command that repeats a run in lockstep; a real delay has no place there."""
    if judged.data.link == ROBOT_SERVER:  # its client has a clock of its own
        return [
            "Stop other programs, or give this one a CPU; funnel-hil doctor says what is missing."
        ]
    if judged.path is None or "real_delay" in manifest:
        return []
    scenario = RunFolder(judged.path).scenario
    if not scenario.exists():
        return []
    command = f"funnel-hil run {shlex.quote(str(scenario))} --set clock=lockstep"
    return [f"Repeat it in virtual time, where the host delays nothing: {command}"]


def _sentences_on_a_stall(stall_ms: float | None, manifest: Mapping[str, Any]) -> list[str]:
    """Return a sentence about a long stall of a loop, with its most likely cause."""
    if stall_ms is None or stall_ms <= STALL_MS:
        return []
    lacked = lacked_grants(manifest)
    if lacked:
        who = " or ".join(_GOES_FIRST[name] for name in lacked)
        cause = f"most likely by {who}, as a loop of this run had no {' and no '.join(lacked)}"
    else:
        is_known = lacked is not None
        cause = "most likely by the host" if is_known else "by the host or by other processes"
    sentence = f"A loop could not run for {stall_ms:.0f} ms, {cause}"
    return [f"{sentence}: this run says little about the law."]
