"""The table of faults: its classes are the kinds of faults that scenarios can schedule."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache, reduce
from operator import or_
from typing import Annotated, Any

from pydantic import Field, PlainValidator, SerializeAsAny, TypeAdapter

from bus_schema.configuration import Sections
from plant_emulator.faults import arm_faults, message_faults, process_faults
from plant_emulator.faults.fault import Fault, FaultContext

FAULT_KINDS: list[type[Fault]] = [
    arm_faults.EncoderStuck,
    arm_faults.EncoderBiased,
    arm_faults.EncoderNoisy,
    arm_faults.TorqueOffset,
    arm_faults.ActuatorWeak,
    arm_faults.ActuatorDead,
    arm_faults.PayloadDropped,
    arm_faults.PayloadPickedUp,
    message_faults.LinkCut,
    message_faults.LinkSlowed,
    message_faults.LinkDuplicated,
    message_faults.LinkCorrupted,
    message_faults.NonFiniteCommand,
    message_faults.SecondCommander,
    message_faults.ClockStep,
    message_faults.ClockDrift,
    process_faults.ProcessKilled,
    process_faults.ProcessFrozen,
    process_faults.ProcessRestarted,
]
"""Each class declares its ``kind`` as a literal, its keys, and its effect."""


def parse_fault(values: Any) -> Fault:
    """Return the fault that an entry of a scenario describes.

    Raises:
        ValidationError: its kind is not in the table, or its keys are wrong.
    """
    fault: Fault = _adapter(tuple(FAULT_KINDS)).validate_python(values)
    return fault


@cache
def _adapter(kinds: tuple[type[Fault], ...]) -> TypeAdapter[Any]:
    union: Any = Annotated[reduce(or_, kinds), Field(discriminator="kind")]
    return TypeAdapter(union)


ScheduledFault = Annotated[
    SerializeAsAny[Fault], PlainValidator(parse_fault), Sections(lambda: FAULT_KINDS)
]
"""An entry of the section ``faults``; the table is read when a scenario is read."""


def check_faults(faults: Sequence[Fault], context: FaultContext) -> None:
    """Check faults against their scenario.

    Args:
        faults: all of them.
        context: that scenario, with the arm's payload at its start.

    Raises:
        ConfigurationError: one refers to something that does not exist, or begins after the end.
    """
    for index, fault in enumerate(faults):
        others = [other for other in faults if other is not fault]
        steps = arm_faults.payload_steps(context.payload_kg, others)
        carried = [payload_kg for at_s, payload_kg in steps if at_s <= fault.at_s]
        fault.check(f"faults.{index}", context._replace(payload_kg=carried[-1]))
