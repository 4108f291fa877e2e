"""Faults that are to happen to drives at given times, as the command line words them."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import NamedTuple

from bus_schema.configuration import ConfigurationError
from plant_emulator.drives.bank import DriveBank
from plant_emulator.drives.drive import DriveFault

_KINDS = "|".join(re.escape(kind) for kind in DriveFault)
_TIME = r"(?:\d+\.?\d*|\.\d+)(?:ms|s)"
_FORM = re.compile(rf"({_KINDS}):(\d+)@({_TIME})(?:\+({_TIME}))?")
_NS = {"ms": 1_000_000, "s": 1_000_000_000}


class PlannedFault(NamedTuple):
    """Something that goes wrong.

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


class FaultPlan:
    """Makes faults happen when their time has come."""

    def __init__(self, faults: Sequence[PlannedFault]) -> None:
        starts = [(fault.start_ns, True, fault) for fault in faults]
        ends = [(fault.end_ns, False, fault) for fault in faults if fault.end_ns is not None]
        self._steps = sorted([*starts, *ends])

    def postpone(self, by_ns: int) -> None:
        """Let everything happen later."""
        self._steps = [(start_ns + by_ns, is_start, f) for start_ns, is_start, f in self._steps]

    def carry_out(self, bank: DriveBank, now_ns: int) -> list[str]:
        """Do what is due; a sentence for each."""
        said = []
        while self._steps and self._steps[0][0] <= now_ns:
            _, is_start, (fault, joint, *_) = self._steps.pop(0)
            if is_start:
                bank.inject(joint, fault, now_ns)
            else:
                bank.heal(joint, fault, now_ns)
            said.append(
                f"{fault} {'injected' if is_start else 'over'} at node {bank.node_ids[joint]}"
            )
        return said


def _nanoseconds(text: str) -> int:
    unit = "ms" if text.endswith("ms") else "s"
    return round(float(text.removesuffix(unit)) * _NS[unit])
