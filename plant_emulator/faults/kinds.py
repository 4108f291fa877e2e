"""The kinds of faults that scenarios can schedule."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from functools import cache, reduce
from operator import or_
from typing import Annotated, Any, get_args

from pydantic import Field, PlainValidator, SerializeAsAny, TypeAdapter

from bus_schema.configuration import Sections
from bus_schema.registry import Registry
from plant_emulator.faults import arm_faults, message_faults, process_faults
from plant_emulator.faults.fault import Fault, FaultContext


def kind_of(fault: type[Fault]) -> str:
    """Return the name that a class of faults declares, as a literal, for its key ``kind``."""
    kinds = get_args(fault.model_fields["kind"].annotation)
    return str(kinds[0]) if len(kinds) == 1 else ""


_SHIPPED: list[type[Fault]] = [
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
FAULT_KINDS: Registry[type[Fault]] = Registry(
    "faults", "faults.kind", Fault, {kind_of(each): each for each in _SHIPPED}
)
"""Each class declares its ``kind`` as a literal, its keys, and its effect."""


def parse_fault(values: Any) -> Fault:
    """Return the fault that an entry of a scenario describes.

    Raises:
        ValidationError: its kind is unknown, or its keys are wrong.
        ValueError: its kind cannot be loaded.
    """
    kind = values.get("kind") if isinstance(values, dict) else None
    named = [kind] if isinstance(kind, str) and kind in FAULT_KINDS else None
    for problem in filter(None, map(_problem, named or ())):
        raise ValueError(f"of a kind that can be used: {problem}")
    fault: Fault = _adapter(_classes(named)).validate_python(values)
    return fault


def _problem(kind: str) -> str:
    """Return the reason why a known kind of fault cannot be used; empty for none."""
    if (problem := FAULT_KINDS.problem(kind)) or kind_of(FAULT_KINDS[kind]) == kind:
        return problem
    return f"{FAULT_KINDS.extension(kind)}: its class must declare kind: Literal[{kind!r}]"


def _classes(only: Collection[str] | None = None) -> tuple[type[Fault], ...]:
    """Return the classes that ship and those of these extensions; None for all extensions."""
    return tuple(each for kind, each in FAULT_KINDS.usable(only).items() if kind_of(each) == kind)


@cache
def _adapter(kinds: tuple[type[Fault], ...]) -> TypeAdapter[Any]:
    union: Any = Annotated[reduce(or_, kinds), Field(discriminator="kind")]
    return TypeAdapter(union)


ScheduledFault = Annotated[SerializeAsAny[Fault], PlainValidator(parse_fault), Sections(_classes)]
"""An entry of the section ``faults``; the kinds are those installed when a scenario is read."""


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
