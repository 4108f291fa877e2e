"""What every scheduled fault has: when it begins and ends, and how it is checked."""

from __future__ import annotations

from typing import Annotated, NamedTuple

from pydantic import Field

from bus_schema.configuration import (
    ConfigurationError,
    NonNegative,
    Number,
    Positive,
    StrictModel,
)

FOREVER_NS = 1 << 62
Share = Annotated[Number, Field(gt=0, le=1)]


class FaultContext(NamedTuple):
    """What a fault is checked against.

    Attributes:
        joint_names: names of the robot's joints.
        duration_s: length of the run.
        payload_kg: mass that the arm carries when the fault begins.
        no_link_faults: what is allowed in place of faults of messages, where the link has none
            that the plant could change; None where it has.
    """

    joint_names: tuple[str, ...]
    duration_s: float
    payload_kg: float
    no_link_faults: str | None


class Fault(StrictModel):
    """What every fault has.

    Attributes:
        kind: which fault.
        at_s: when it begins, on the run's clock.
        for_s: how long it lasts; to the end of the run if left out.
    """

    kind: str
    at_s: NonNegative
    for_s: Positive | None = None

    @property
    def start_ns(self) -> int:
        return round(self.at_s * 1e9)

    @property
    def end_ns(self) -> int:
        return FOREVER_NS if self.for_s is None else round((self.at_s + self.for_s) * 1e9)

    def is_active(self, now_ns: int) -> bool:
        return self.start_ns <= now_ns < self.end_ns

    def check(self, key: str, context: FaultContext) -> None:
        """Check the fault against the scenario it is part of.

        Args:
            key: where in the scenario it stands.
            context: what it may refer to.

        Raises:
            ConfigurationError: it refers to what is not there, or begins after the end.
        """
        if self.at_s >= context.duration_s:
            allowed = f"below duration_s = {context.duration_s}"
            raise ConfigurationError(f"{key}.at_s", self.at_s, allowed)

    def __str__(self) -> str:
        """The fault in a few words: its kind, and the values that are its own."""
        common = ("kind", "at_s", "for_s")
        own = [f"{key} {value}" for key, value in self if key not in common and value is not None]
        return ", ".join([self.kind, *own])
