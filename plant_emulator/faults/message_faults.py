"""Faults in messages: wrong content, or another sender."""

from __future__ import annotations

import math
from abc import abstractmethod
from collections.abc import Callable, Iterable, Iterator
from typing import Annotated, ClassVar, Literal

from pydantic import Field

from bus_schema.configuration import ConfigurationError, Number, Positive
from bus_schema.errors import InvalidMessageError
from bus_schema.link.interface import CommandArrival
from bus_schema.messages.layout import MessageLayout
from bus_schema.messages.record import Record
from bus_schema.messages.types import stamp_of, with_stamp
from plant_emulator.channel.conditions import Conditions
from plant_emulator.faults.fault import Fault, FaultContext, Share

Direction = Literal["uplink", "downlink"]
Messages = tuple[bytes, ...]


class LinkFault(Fault):
    """A fault of messages, for links whose messages the plant can change."""

    def check(self, key: str, context: FaultContext) -> None:
        super().check(key, context)
        if context.no_link_faults is not None:
            raise ConfigurationError(f"{key}.kind", self.kind, context.no_link_faults)


class ChannelFault(LinkFault):
    """Attributes: direction: of the link."""

    direction: Direction

    @abstractmethod
    def changed(self, conditions: Conditions) -> Conditions:
        """Return the conditions of the channel while the fault lasts."""


class LinkCut(ChannelFault):
    """Loses every message."""

    kind: Literal["link_cut"]

    def changed(self, conditions: Conditions) -> Conditions:
        return conditions._replace(loss=1.0)


class LinkSlowed(ChannelFault):
    """Attributes: delay_ms: added to the delay of every message."""

    kind: Literal["link_slowed"]
    delay_ms: Positive

    def changed(self, conditions: Conditions) -> Conditions:
        return conditions._replace(delay_ns=conditions.delay_ns + self.delay_ms * 1e6)


class LinkDuplicated(ChannelFault):
    """Attributes: share: probability that a message arrives twice."""

    kind: Literal["link_duplicated"]
    share: Share = 1.0

    def check(self, key: str, context: FaultContext) -> None:
        super().check(key, context)
        if context.no_duplicates is not None:
            raise ConfigurationError(f"{key}.kind", self.kind, context.no_duplicates)

    def changed(self, conditions: Conditions) -> Conditions:
        return conditions._replace(duplicate=max(conditions.duplicate, self.share))


def channel_faults(faults: Iterable[Fault], direction: Direction) -> list[ChannelFault]:
    """Return the faults of one direction of the link."""
    return [f for f in faults if isinstance(f, ChannelFault) and f.direction == direction]


SECOND_COMMANDER = b"second commander"
"""Sender id of the second commander."""


class MessageEditor:
    """Edits messages for faults.

    Args:
        layout: of commands.
        uniform: random numbers from 0 to below 1.
    """

    def __init__(self, layout: MessageLayout, uniform: Iterator[float]) -> None:
        self._layout = layout
        self._command = Record(layout)
        self._uniform = uniform

    def happens(self, probability: float) -> bool:
        """Draw whether an event of this probability happens now."""
        return next(self._uniform) < probability

    def cut_off(self, payload: bytes) -> bytes:
        """Return a message cut off at a random byte."""
        return payload[: int(next(self._uniform) * len(payload))]

    @staticmethod
    def restamped(payload: bytes, change: Callable[[int], int]) -> bytes:
        """Return a message whose header's stamp is changed, but not to before 0."""
        stamp_ns = stamp_of(payload)
        return payload if stamp_ns is None else with_stamp(payload, max(0, change(stamp_ns)))

    def with_torque(self, command: bytes, torque_nm: float, *, joints: slice) -> bytes:
        """Return a command with another torque; an unreadable command is not changed."""
        try:
            self._layout.decode(command, self._command)
        except InvalidMessageError:
            return command
        self._command.fields["effort"][joints] = torque_nm
        return self._command.payload()


class MessageFault(LinkFault):
    """A fault in messages.

    Attributes:
        happens_on_the_way: the link causes it; otherwise the sender does, earlier.
    """

    happens_on_the_way: ClassVar[bool] = False

    @abstractmethod
    def changed(self, direction: Direction, messages: Messages, editor: MessageEditor) -> Messages:
        """Return messages that are sent together as the fault changes them, if it does.

        Args:
            direction: their direction on the link.
            messages: on the uplink a joint state and its plant status, on the downlink a command.
            editor: edits them.
        """


class LinkCorrupted(MessageFault):
    """Cuts messages off at a random byte, so that they cannot be read.

    Attributes:
        share: probability that a message is cut off.
    """

    kind: Literal["link_corrupted"]
    direction: Direction
    share: Share = 1.0
    happens_on_the_way: ClassVar[bool] = True

    def changed(self, direction: Direction, messages: Messages, editor: MessageEditor) -> Messages:
        if direction != self.direction:
            return messages
        first, *others = messages
        return (editor.cut_off(first), *others) if editor.happens(self.share) else messages


class NonFiniteCommand(MessageFault):
    """Replaces one joint's torque by NaN in every command, as from a law that divides by zero."""

    kind: Literal["non_finite_command"]

    def changed(self, direction: Direction, messages: Messages, editor: MessageEditor) -> Messages:
        if direction == "uplink":
            return messages
        return tuple(editor.with_torque(each, math.nan, joints=slice(1)) for each in messages)


class ClockStep(MessageFault):
    """Shifts the clock of one side: its stamps are wrong.

    Attributes:
        side: whose clock; the plant's stamps states, the controller's commands.
        step_ms: by how much.
    """

    kind: Literal["clock_step"]
    side: Literal["plant", "controller"]
    step_ms: Number

    def changed(self, direction: Direction, messages: Messages, editor: MessageEditor) -> Messages:
        if direction != ("uplink" if self.side == "plant" else "downlink"):
            return messages
        step_ns = round(self.step_ms * 1e6)
        return tuple(editor.restamped(each, step_ns.__add__) for each in messages)


class ClockDrift(MessageFault):
    """The controller's clock runs faster than the plant's from the start of the fault on.

    The controller follows its reference by its own clock, so ever further ahead of the plant's.

    Attributes:
        ppm: by how much; negative for a slower clock. 100 ppm are 2 ms after 20 s.
    """

    kind: Literal["clock_drift"]
    ppm: Annotated[Number, Field(ge=-100_000, le=100_000)]
    for_s: None = None

    def changed(self, direction: Direction, messages: Messages, editor: MessageEditor) -> Messages:
        ppb, is_uplink = round(self.ppm * 1e3), direction == "uplink"

        def shifted_ns(stamp_ns: int) -> int:
            elapsed_ns = max(0, stamp_ns - self.start_ns)
            if is_uplink:
                return stamp_ns + elapsed_ns * ppb // 10**9
            # The inverse in whole numbers, never later: the plant would know no such state yet.
            return stamp_ns - elapsed_ns * ppb // (10**9 + ppb)

        return tuple(editor.restamped(each, shifted_ns) for each in messages)


class SecondCommander(LinkFault):
    """Adds a session that answers every state too, just before the controller.

    Attributes:
        torque_nm: torque that it commands for every joint.
    """

    kind: Literal["second_commander"]
    torque_nm: Number

    def added_command(self, arrival: CommandArrival, editor: MessageEditor) -> CommandArrival:
        """Return the command to insert just before one of the controller's, still unnumbered."""
        payload = editor.with_torque(arrival.payload, self.torque_nm, joints=slice(None))
        return arrival._replace(payload=payload, sender=SECOND_COMMANDER)
