"""CPUs for real-time loops, one each: two loops on one CPU take each other's deadlines."""

from __future__ import annotations

import contextlib
import socket
from collections.abc import Sequence

from bus_schema.runtime.realtime import AFFINITY, RealtimeSetting

_UNTIL_THE_END = contextlib.ExitStack()
"""Holds what was claimed; the end of the process, of whatever kind, gives it back."""


def claim_cpu(candidates: Sequence[int]) -> int | None:
    """The first of some CPUs that no other process has claimed, from now on this one's.

    A claim is a socket in Linux's abstract namespace: nothing is left over by a process that is
    killed, and users need no folder in common.

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
    """What to report where all have been claimed."""
    shown = ", ".join(map(str, sorted(candidates)))
    return RealtimeSetting(
        AFFINITY,
        False,
        f"each of the CPUs {shown} has a real-time loop of another run, behind which this one waits"
        ": expect missed deadlines, or end the other run first",
    )
