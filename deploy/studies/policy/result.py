"""The numbers of a policy that a gate reads."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Annotated

from pydantic import Field

from deploy.judge.gate import Finite, Gauged
from deploy.reports.gauges import JERK, MM, GaugedSummary, Part


class _At(Part):
    inference_ms: Finite
    jump_mm: Finite | None
    jerk_rad_s3: Finite | None


class _Case(Part):
    arm: str
    merge: str
    inference_ms: Finite | None
    at: _At | None


class GaugedPolicy(GaugedSummary):
    """A policy: its largest inference time with each merge; in mm and rad/s3, jump and jerk."""

    group = "policy"
    other_units = (MM, JERK)
    cases: Annotated[list[_Case], Field(min_length=1)]

    def numbers(self) -> Iterator[Gauged]:
        for case in self.cases:
            name, at = f"{case.arm}, {case.merge}", case.at
            yield Gauged(f"{name}, inference time", case.inference_ms, "ms")
            if at is not None:
                where = f"at {at.inference_ms:g} ms"
                yield Gauged(f"{name}, jump of the tip {where}", at.jump_mm, MM, sign=-1)
                yield Gauged(f"{name}, jerk {where}", at.jerk_rad_s3, JERK, sign=-1)
