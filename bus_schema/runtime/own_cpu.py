"""CPUs for real-time loops, one each: two loops on one CPU make each other miss deadlines."""

from __future__ import annotations

import contextlib
import socket
from collections.abc import Sequence

from bus_schema.runtime.realtime import AFFINITY, RealtimeSetting

_UNTIL_THE_END = contextlib.ExitStack()
"""Holds the claimed CPUs until the process ends in any way."""


def claim_cpu(candidates: Sequence[int]) -> int | None:
    """Claim and return the first of these CPUs that no other process has claimed.

    A claim is a socket in Linux's abstract namespace: a killed process leaves nothing behind, and
    users need no common folder.

    Args:
        candidates: numbers of CPUs, the best first.
    """
    for cpu in candidates:
        claim = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        try:
            claim.bind(f"\0funnel-hil-cpu-{cpu}")
        except OSError:
            claim.close()
            continue
        _UNTIL_THE_END.enter_context(claim)
        return cpu
    return None


def none_is_free(candidates: Sequence[int]) -> RealtimeSetting:
    """Return the report for the case that all CPUs have been claimed."""
    shown = ", ".join(map(str, sorted(candidates)))
    return RealtimeSetting(
        AFFINITY,
        False,
        f"each of the CPUs {shown} has a real-time loop of another run, for which this run waits:"
        " expect missed deadlines, or end the other run first",
    )
