"""The table of faults: a class that is in it is a kind of fault that scenarios can schedule."""

from __future__ import annotations

from collections.abc import Iterable
from functools import cache, reduce
from operator import or_
from typing import Annotated, Any

from pydantic import Field, PlainValidator, SerializeAsAny, TypeAdapter

from plant_emulator.faults.arm_faults import (
    ActuatorDead,
    ActuatorWeak,
    EncoderBiased,
    EncoderNoisy,
    EncoderStuck,
    PayloadDropped,
    TorqueOffset,
)
from plant_emulator.faults.channel_faults import LinkCut, LinkDuplicated, LinkSlowed
from plant_emulator.faults.fault import Fault, FaultContext
from plant_emulator.faults.message_faults import (
    ClockStep,
    LinkCorrupted,
    NonFiniteCommand,
    SecondCommander,
)
from plant_emulator.faults.process_faults import ProcessFrozen, ProcessKilled, ProcessRestarted

FAULT_KINDS: list[type[Fault]] = [
    EncoderStuck,
    EncoderBiased,
    EncoderNoisy,
    TorqueOffset,
    ActuatorWeak,
    ActuatorDead,
    PayloadDropped,
    LinkCut,
    LinkSlowed,
    LinkDuplicated,
    LinkCorrupted,
    NonFiniteCommand,
    SecondCommander,
    ClockStep,
    ProcessKilled,
    ProcessFrozen,
    ProcessRestarted,
]
"""Each declares its ``kind`` as a literal, its keys, and what it does."""


def parse_fault(values: Any) -> Fault:
    """The fault that an entry of a scenario describes.

    Raises:
        ValidationError: it is of no kind of the table, or its keys are wrong.
    """
    fault: Fault = _adapter(tuple(FAULT_KINDS)).validate_python(values)
    return fault


@cache
def _adapter(kinds: tuple[type[Fault], ...]) -> TypeAdapter[Any]:
    union: Any = Annotated[reduce(or_, kinds), Field(discriminator="kind")]
    return TypeAdapter(union)


ScheduledFault = Annotated[SerializeAsAny[Fault], PlainValidator(parse_fault)]
"""An entry of the section ``faults``; the table is looked at when a scenario is read."""


def check_faults(faults: Iterable[Fault], context: FaultContext) -> None:
    """Check faults against the scenario they are part of.

    Raises:
        ConfigurationError: one refers to what is not there, or begins after the end.
    """
    for index, fault in enumerate(faults):
        fault.check(f"faults.{index}", context)
