"""The ``faults`` of a scenario: what the plant emulates, and what is done to whole processes."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from enum import StrEnum
from functools import partial
from typing import Annotated, Any, Literal, NamedTuple

from pydantic import Field

from bus_schema.configuration import ConfigurationError, Positive
from bus_schema.messages.topics import Role
from deploy.link_kinds.kind import LinkKind
from plant_emulator.fault_configuration import (
    Fault,
    JointFault,
    PayloadDropped,
    PlantFault,
)
from plant_emulator.faults.faulty_link import Strike


class ProcessFault(Fault):
    """Attributes: target: the process that is struck."""

    target: Literal["controller", "plant", "recorder"]


class ProcessKilled(ProcessFault):
    """SIGKILL, and it stays away."""

    kind: Literal["process_killed"]
    for_s: None = None


class ProcessFrozen(ProcessFault):
    """SIGSTOP, and SIGCONT after ``for_s``, of the plant's clock; of the wall's for the plant."""

    kind: Literal["process_frozen"]
    for_s: Positive


class ProcessRestarted(ProcessFault):
    """SIGKILL, and a new process in its place after ``for_s``, likewise."""

    kind: Literal["process_restarted"]
    for_s: Positive


ScheduledFault = Annotated[
    PlantFault | ProcessKilled | ProcessFrozen | ProcessRestarted, Field(discriminator="kind")
]


class Blow(StrEnum):
    """What is done to a process."""

    KILL = "kill"
    TAKE_AWAY = "take away"
    BRING_BACK = "bring back"
    FREEZE = "freeze"
    THAW = "thaw"


class Order(NamedTuple):
    """A blow to be struck.

    Attributes:
        undone_by: the blow that ends it after `for_s` of wall time; None where nothing does, or
            where the plant's clock says when.
    """

    target: Role
    blow: Blow
    undone_by: Blow | None = None
    for_s: float = 0.0


_BLOWS: dict[type[ProcessFault], tuple[Blow, Blow | None]] = {
    ProcessKilled: (Blow.KILL, None),
    ProcessFrozen: (Blow.FREEZE, Blow.THAW),
    ProcessRestarted: (Blow.TAKE_AWAY, Blow.BRING_BACK),
}


def plant_faults(faults: Iterable[Fault]) -> tuple[Fault, ...]:
    """The faults that the plant emulates."""
    return tuple(fault for fault in faults if not isinstance(fault, ProcessFault))


def process_faults(faults: Iterable[Fault]) -> list[ProcessFault]:
    """The faults of whole processes."""
    return [fault for fault in faults if isinstance(fault, ProcessFault)]


def process_strikes(faults: Iterable[Fault], strike: Callable[[Order], None]) -> tuple[Strike, ...]:
    """What the plant has to say, and when, for the faults of processes to happen on its clock.

    A plant that is dead or frozen has no clock: when such a fault ends is said at its beginning.
    """
    strikes = []
    for fault in process_faults(faults):
        target, (blow, undoing) = Role(fault.target), _BLOWS[type(fault)]
        if undoing is None or fault.for_s is None:
            order = Order(target, blow)
        elif target is Role.PLANT:
            order = Order(target, blow, undoing, fault.for_s)
        else:
            order = Order(target, blow)
            end = partial(strike, Order(target, undoing))
            strikes.append(Strike(fault.end_ns, f"{fault}: is over", end))
        strikes.append(Strike(fault.start_ns, f"{fault}: begins", partial(strike, order)))
    return tuple(strikes)


def check_faults(
    faults: Sequence[Fault],
    joint_names: tuple[str, ...],
    duration_s: float,
    payload_kg: float,
    link_kind: LinkKind[Any],
) -> None:
    """Check faults against the scenario they are part of.

    Raises:
        ConfigurationError: one refers to what is not there, or comes after the end.
    """
    for index, fault in enumerate(faults):
        key = f"faults.{index}"
        if fault.at_s >= duration_s:
            raise ConfigurationError(f"{key}.at_s", fault.at_s, f"below duration_s = {duration_s}")
        if isinstance(fault, link_kind.refused_faults):
            raise ConfigurationError(f"{key}.kind", fault.kind, link_kind.refusal)
        if isinstance(fault, JointFault) and fault.joint not in joint_names:
            allowed = f"one of {', '.join(joint_names)}"
            raise ConfigurationError(f"{key}.joint", fault.joint, allowed)
        if isinstance(fault, PayloadDropped) and payload_kg == 0.0:
            allowed = "there is nothing to drop: plant.payload_kg must be above 0"
            raise ConfigurationError(f"{key}.kind", fault.kind, allowed)
