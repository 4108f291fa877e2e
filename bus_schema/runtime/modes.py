"""What controller and plant may be doing, and how each gets from one to the other: one table."""

from __future__ import annotations

from collections.abc import Mapping
from enum import IntEnum, StrEnum
from types import MappingProxyType

from bus_schema.errors import BusError


class Mode(IntEnum):
    """What a side does; for the plant, numbers as in PlantStatus.msg."""

    IDLE = 0
    READY = 1
    TRACKING = 2
    STOPPING = 3
    FAULT = 4


COMMANDABLE = (Mode.TRACKING, Mode.READY)
"""Modes in which a torque is given, or waited for."""


class Trigger(StrEnum):
    """What makes a side change its mode.

    Attributes:
        BEGIN: it takes part from here on; a plant holds its brakes.
        COMMAND: the first torque: a plant's brakes are released.
        FAIL: it cannot go on, for whatever reason.
        STOPPED: what had to be done to stop is done.
        END: the run is over, and nothing went wrong.
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
"""All that can happen. There is no way to FAULT but through STOPPING, and none out of it."""


class IllegalTransitionError(BusError, RuntimeError):
    """A trigger that means nothing in the mode in which it came.

    Attributes:
        mode: the mode.
        trigger: the trigger.
    """

    def __init__(self, mode: Mode, trigger: Trigger) -> None:
        super().__init__(f"in mode {mode.name} nothing follows from {trigger.name}")
        self.mode = mode
        self.trigger = trigger


def follow(mode: Mode, trigger: Trigger) -> Mode:
    """The mode that follows.

    Raises:
        IllegalTransitionError: the table has no such transition.
    """
    try:
        return TRANSITIONS[mode, trigger]
    except KeyError:
        raise IllegalTransitionError(mode, trigger) from None


def mode_event(mode: Mode, why: str) -> str:
    """Detail of the run event that tells of a change of mode."""
    return f"{mode.name.lower()}: {why}"


def mode_in(detail: str) -> Mode | None:
    """The mode that such a detail tells of, or None if it tells of none."""
    return Mode.__members__.get(detail.partition(":")[0].upper())
