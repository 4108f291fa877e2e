"""State machine of controller and plant: modes, triggers and one table of transitions."""

from __future__ import annotations

from collections.abc import Mapping
from enum import IntEnum, StrEnum
from types import MappingProxyType

from bus_schema.errors import BusError


class Mode(IntEnum):
    """Modes of a side; the plant's are numbered as in PlantStatus.msg."""

    IDLE = 0
    READY = 1
    TRACKING = 2
    STOPPING = 3
    FAULT = 4


COMMANDABLE = (Mode.TRACKING, Mode.READY)
"""Modes in which a torque is sent or awaited."""


class Trigger(StrEnum):
    """Triggers that change the mode.

    Attributes:
        BEGIN: the side joins the run; a plant holds its brakes.
        COMMAND: the first torque arrives: a plant releases its brakes.
        FAIL: it cannot go on, for any reason.
        STOPPED: the stop is complete.
        END: the run ends without a fault.
    """

    BEGIN = "begin"
    COMMAND = "command"
    FAIL = "fail"
    STOPPED = "stopped"
    END = "end"


TRANSITIONS: Mapping[tuple[Mode, Trigger], Mode] = MappingProxyType({
    (Mode.IDLE, Trigger.BEGIN): Mode.READY,
    (Mode.READY, Trigger.COMMAND): Mode.TRACKING,
    (Mode.READY, Trigger.FAIL): Mode.STOPPING,
    (Mode.TRACKING, Trigger.FAIL): Mode.STOPPING,
    (Mode.STOPPING, Trigger.STOPPED): Mode.FAULT,
    (Mode.READY, Trigger.END): Mode.IDLE,
    (Mode.TRACKING, Trigger.END): Mode.IDLE,
})  # fmt: skip
"""All transitions. FAULT is reached only through STOPPING, and never left."""


class IllegalTransitionError(BusError, RuntimeError):
    """The trigger is not allowed in the current mode.

    Attributes:
        mode: the mode.
        trigger: the trigger.
    """

    def __init__(self, mode: Mode, trigger: Trigger) -> None:
        super().__init__(f"in mode {mode.name} nothing follows from {trigger.name}")
        self.mode = mode
        self.trigger = trigger


def follow(mode: Mode, trigger: Trigger) -> Mode:
    """Return the next mode.

    Raises:
        IllegalTransitionError: the table has no such transition.
    """
    try:
        return TRANSITIONS[mode, trigger]
    except KeyError:
        raise IllegalTransitionError(mode, trigger) from None


def mode_event(mode: Mode, why: str) -> str:
    """Return the detail of the run event that reports a change of mode."""
    return f"{mode.name.lower()}: {why}"


def mode_in(detail: str) -> Mode | None:
    """Return the mode that such a detail reports, or None."""
    return Mode.__members__.get(detail.partition(":")[0].upper())
