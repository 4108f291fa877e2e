"""Common base of all scheduled faults: start, end and checks."""

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
    """Context in which a fault is checked.

    Attributes:
        joint_names: names of the robot's joints.
        duration_s: length of the run.
        payload_kg: mass that the arm carries when the fault begins.
        no_link_faults: what is allowed instead of faults of messages, if the plant cannot change
            this link's messages; None if it can.
    """

    joint_names: tuple[str, ...]
    duration_s: float
    payload_kg: float
    no_link_faults: str | None


class Fault(StrictModel):
    """Keys that all faults have.

    Attributes:
        kind: which fault.
        at_s: start, on the run's clock.
        for_s: duration; if optional and left out, the fault lasts to the end of the run.
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
        """Check the fault against its scenario.

        Args:
            key: its key in the scenario.
            context: what it may refer to.

        Raises:
            ConfigurationError: it refers to something that does not exist, or begins after the end.
        """
        if self.at_s >= context.duration_s:
            allowed = f"below duration_s = {context.duration_s}"
            raise ConfigurationError(f"{key}.at_s", self.at_s, allowed)

    def __str__(self) -> str:
        """Describe the fault in a few words: its kind, and its own values."""
        common = ("kind", "at_s", "for_s")
        own = [f"{key} {value}" for key, value in self if key not in common and value is not None]
        return ", ".join([self.kind, *own])
