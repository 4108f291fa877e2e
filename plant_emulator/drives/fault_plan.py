"""Faults of drives at given times, in the format of the command line."""

from __future__ import annotations

import re
from collections.abc import Sequence
from functools import partial
from typing import NamedTuple

from bus_schema.configuration import ConfigurationError
from plant_emulator.drives.bank import DriveBank
from plant_emulator.drives.drive import DriveFault
from plant_emulator.faults.fault import FaultScheduler, ScheduledAction

_KINDS = "|".join(re.escape(kind) for kind in DriveFault)
_TIME = r"(?:\d+\.?\d*|\.\d+)(?:ms|s)"
_FORM = re.compile(rf"({_KINDS}):(\d+)@({_TIME})(?:\+({_TIME}))?")
_NS = {"ms": 1_000_000, "s": 1_000_000_000}


class PlannedFault(NamedTuple):
    """One planned fault of a drive.

    Attributes:
        joint: whose drive, counted from 0.
        start_ns: when.
        end_ns: when its cause is gone; None for never.
    """

    fault: DriveFault
    joint: int
    start_ns: int
    end_ns: int | None


def parse_fault(text: str, node_ids: Sequence[int]) -> PlannedFault:
    """A fault of the form ``kind:node@time[+duration]``, such as ``silent:2@3s+500ms``.

    Raises:
        ConfigurationError: the text is no such thing, or names a node that there is not.
    """
    match = _FORM.fullmatch(text)
    if match is None:
        raise ConfigurationError(
            "--fault", text,
            "must be kind:node@time or kind:node@time+duration, such as drive:2@3s or"
            f" silent:1@500ms+2s, with a kind of {', '.join(DriveFault)}",
        )  # fmt: skip
    kind, node, start, duration = match.groups()
    if int(node) not in node_ids:
        nodes = ", ".join(str(each) for each in node_ids)
        raise ConfigurationError("--fault", text, f"must name one of the nodes {nodes}")
    start_ns = _nanoseconds(start)
    end_ns = None if duration is None else start_ns + _nanoseconds(duration)
    return PlannedFault(DriveFault(kind), list(node_ids).index(int(node)), start_ns, end_ns)


def schedule_faults(faults: Sequence[PlannedFault], bank: DriveBank) -> FaultScheduler:
    """Applies planned faults to drives at their times."""
    begins, ends = [], []
    for fault, joint, start_ns, end_ns in sorted(faults, key=lambda each: each[:2]):
        node = bank.node_ids[joint]
        begin = partial(bank.inject, joint, fault)
        begins.append(ScheduledAction(start_ns, f"{fault} injected at node {node}", begin))
        if end_ns is not None:
            end = partial(bank.clear, joint, fault)
            ends.append(ScheduledAction(end_ns, f"{fault} over at node {node}", end))
    return FaultScheduler([*ends, *begins])


def _nanoseconds(text: str) -> int:
    unit = "ms" if text.endswith("ms") else "s"
    return round(float(text.removesuffix(unit)) * _NS[unit])
