"""The gate every command passes: nothing invalid, stale or unasked-for comes through."""

from __future__ import annotations

import logging
from typing import NamedTuple

from bus_schema import topics
from bus_schema.arrays import Vector
from bus_schema.cdr_layout import Record
from bus_schema.errors import InvalidMessageError
from bus_schema.finite import all_finite
from bus_schema.link import CommandArrival
from bus_schema.rejections import Rejections

logger = logging.getLogger(__name__)


class Command(NamedTuple):
    """A valid command.

    Attributes:
        torque_nm: shape (joints,).
        sequence: number its sender gave it.
        stamp_ns: stamp of the state it answers.
    """

    torque_nm: Vector
    sequence: int
    stamp_ns: int


class CommandGate:
    """Decodes commands and keeps out what is not valid, finite, right-sized and newer.

    Attributes:
        rejections: what was kept out.
        awaited_ns: stamp of the state whose answer is waited for; None once it has come, be it
            new or a repetition.
    """

    def __init__(self, joint_names: tuple[str, ...]) -> None:
        self._layout = topics.layout(topics.JOINT_COMMANDS, joint_names)
        self._record = Record(self._layout)
        self.rejections = Rejections("command", logger)
        self._newest_ns = -1
        self.awaited_ns: int | None = None

    def admit(self, arrival: CommandArrival, newest_state_ns: int) -> Command | None:
        """The command in `arrival`, or None if it must change nothing.

        Args:
            arrival: what came off the bus.
            newest_state_ns: stamp of the newest state that was sent out.
        """
        try:
            return self._admit(arrival, newest_state_ns)
        except InvalidMessageError as error:
            self.rejections.note(error)
            return None

    def _admit(self, arrival: CommandArrival, newest_state_ns: int) -> Command:
        self._layout.decode(arrival.payload, self._record)
        torque = self._record.fields["effort"]
        stamp_ns = self._record.stamp_ns
        if not all_finite(torque):
            raise InvalidMessageError("not_finite", "a torque is not finite")
        if stamp_ns > newest_state_ns:
            raise InvalidMessageError("from_the_future", "it answers a state that was never sent")
        if stamp_ns == self.awaited_ns:
            self.awaited_ns = None
        if stamp_ns <= self._newest_ns:
            raise InvalidMessageError("stale", "it answers a state no newer than the last one did")
        self._newest_ns = stamp_ns
        return Command(torque.copy(), arrival.sequence, stamp_ns)
