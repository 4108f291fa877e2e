"""The gate for commands: it rejects invalid, stale, replayed and foreign ones."""

from __future__ import annotations

import logging
from collections import OrderedDict
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from bus_schema.arrays import Matrix, Vector
from bus_schema.errors import InvalidMessageError, Rejections
from bus_schema.link.interface import CommandArrival
from bus_schema.messages import topics
from bus_schema.messages.record import Record
from bus_schema.runtime.compiled import all_finite, bind

_REMEMBERED = 1000
"""Messages remembered; a link reorders far fewer."""


class SenderNumbers:
    """Recognises repeated messages, and two senders that use one sender's name.

    A sender counts its messages. No link creates one number with two contents, or a number far
    behind another. An impostor who continues the count of a silent sender is not detected.

    Attributes:
        second_source: evidence of a second sender under this name; None without any.
    """

    def __init__(self) -> None:
        self._contents: OrderedDict[int, int] = OrderedDict()  # hash by number, oldest first
        self._highest = 0
        self.second_source: str | None = None

    def is_new(self, number: int, payload: bytes) -> bool:
        """Whether no message of this number came lately; this call counts as one.

        Args:
            number: the sender's number of the message.
            payload: its contents.
        """
        contents = hash(payload)
        known = self._contents.get(number)
        if known is not None:
            if known != contents:
                self.second_source = f"two commands with number {number} have different contents"
            return False
        if number < self._highest - _REMEMBERED:
            self.second_source = f"number {number} came after {self._highest}"
        self._highest = max(number, self._highest)
        self._contents[number] = contents
        if len(self._contents) > _REMEMBERED:
            self._contents.popitem(last=False)
        return True


logger = logging.getLogger(__name__)


class Rows(NamedTuple):
    """Rows of a command, from its first on.

    Attributes:
        torques_nm: shape (rows, joints).
        targets: for the drives, each as of its own tick, shape (rows, 2, joints); None for none.
        ticks: from one row to the next; torques and targets change linearly in between.
    """

    torques_nm: Matrix
    targets: Matrix | None
    ticks: int

    @property
    def last_tick(self) -> int:
        """Tick of the last row, counted from the first; later ones repeat it."""
        return (len(self.torques_nm) - 1) * self.ticks

    def at(self, tick: int) -> tuple[Vector, Matrix | None]:
        """Return torque and target of a tick up to the last one."""
        target = None if self.targets is None else self._between(self.targets, tick)
        return self._between(self.torques_nm, tick), target

    def _between(self, table: NDArray[np.float64], tick: int) -> NDArray[np.float64]:
        row, rest = divmod(tick, self.ticks)
        value: NDArray[np.float64] = table[row]
        if rest:
            value = value + rest / self.ticks * (table[row + 1] - value)
        return value


class Command(NamedTuple):
    """A valid command.

    Attributes:
        torque_nm: shape (joints,).
        sequence: number its sender gave it.
        stamp_ns: stamp of the state it answers.
        target: for the drives, as of that stamp: position, rad, and velocity, rad/s, as rows, shape
            (2, joints); None for none.
        rows: its rows, where it has several, for the following ticks too; else None.
        acts_after_ns: time from that stamp until it acts; 0 for on arrival.
    """

    torque_nm: Vector
    sequence: int
    stamp_ns: int
    target: Matrix | None = None
    rows: Rows | None = None
    acts_after_ns: int = 0


class CommandGate:
    """Rejects commands that are invalid, not finite, of wrong shape, old, or not the commander's.

    The first sender of a valid command becomes the commander; others are rejected until it has left
    the bus. A restarted controller has a new session, and so is another sender.

    Only an accepted command changes the limits; a rejected one only uses up its number. Without
    link.security, anyone can send under the commander's id. The gate does not prevent that;
    `second_source` reports visible evidence.

    Args:
        joint_names: names of the joints.
        has_left: whether a sender was on the bus and has left.
        takes_targets: whether commands may contain targets for the drives.
        takes_acting_time: whether commands may say when they act.

    Attributes:
        layout: of commands.
        rejections: the rejected commands.
        newest_ns: stamp of the state that the newest command answers; commands that answer older
            ones are rejected. -1 before the first.
        is_waiting: the answer for `await_answer` has not arrived, new or as a repetition.
        commander: session of the accepted sender; None before the first valid command.
    """

    def __init__(
        self,
        joint_names: tuple[str, ...],
        has_left: Callable[[bytes], bool] = lambda _: False,
        *,
        takes_targets: bool = False,
        takes_acting_time: bool = False,
    ) -> None:
        self.layout = topics.layout(
            topics.JOINT_COMMANDS, joint_names,
            has_targets=takes_targets, has_acting_time=takes_acting_time,
        )  # fmt: skip
        self._record = Record(self.layout)
        self._torque_nm = self._record.fields["effort"]
        self._target = self._record.rows("position", "velocity") if takes_targets else None
        self._is_finite = bind(all_finite, self._torque_nm)
        self._has_left = has_left
        self.rejections = Rejections("command", logger)
        self.newest_ns = -1
        self._newest_sequence = 0
        self.is_waiting = False
        self._awaited_ns = -1
        self.commander: bytes | None = None
        self._numbers = SenderNumbers()

    @property
    def second_source(self) -> str | None:
        """Evidence that two senders use the commander's id; None without any."""
        return self._numbers.second_source

    def admit(self, arrival: CommandArrival, newest_state_ns: int) -> Command | None:
        """Return the command in `arrival`, or None if it is rejected.

        Args:
            arrival: what came off the bus.
            newest_state_ns: stamp of the newest state sent.
        """
        try:
            return self._admit(arrival, newest_state_ns)
        except InvalidMessageError as error:
            self.rejections.note(error)
            return None

    def await_answer(self, stamp_ns: int) -> None:
        """Wait from now on for the answer to the state of this stamp."""
        self.is_waiting, self._awaited_ns = True, stamp_ns

    def stop_waiting(self) -> None:
        """Stop waiting: no answer will come, or a damaged one counts."""
        self.is_waiting = False

    def lacks_commander(self) -> bool:
        """Whether the commander has left the bus: the next sender of a command replaces it."""
        return self.commander is not None and self._has_left(self.commander)

    def _admit(self, arrival: CommandArrival, newest_state_ns: int) -> Command:
        stamp_ns = self.layout.decode(arrival.payload, self._record)
        if not self._is_finite():
            raise InvalidMessageError("not_finite", "a torque is not finite")
        target = None if self._target is None else _given(self._target.copy())
        rows = None if self._record.later is None else self._rows(self._record.later, target)
        if stamp_ns > newest_state_ns:
            raise InvalidMessageError("from_the_future", "it answers a state that was never sent")
        self._require_commander(arrival)
        if stamp_ns == self._awaited_ns:
            self.is_waiting = False
        if stamp_ns <= self.newest_ns:
            raise InvalidMessageError(
                "stale", "its state is not newer than that of the last command"
            )
        self.newest_ns = stamp_ns
        self._newest_sequence = arrival.sequence
        if arrival.sender != self.commander:
            self.commander, self._numbers = arrival.sender, SenderNumbers()
            self._numbers.is_new(arrival.sequence, arrival.payload)
        acts_after_ns = self._record.acts_after_ns
        return Command(
            self._torque_nm.copy(), arrival.sequence, stamp_ns, target, rows, acts_after_ns
        )

    def _rows(self, later: NDArray[np.void], target: Matrix | None) -> Rows:
        torques_nm = np.empty((1 + len(later), self._torque_nm.size))
        torques_nm[0], torques_nm[1:] = self._torque_nm, later["effort"]
        if not np.isfinite(torques_nm).all():
            raise InvalidMessageError("not_finite", "a torque of a later row is not finite")
        targets = None
        if target is not None:
            following = np.empty((len(torques_nm), *target.shape))
            following[0] = target
            following[1:, 0], following[1:, 1] = later["position"], later["velocity"]
            targets = _given(following)
        return Rows(torques_nm, targets, self._record.row_ticks)

    def _require_commander(self, arrival: CommandArrival) -> None:
        """Refuse other senders than the commander, and repetitions of its commands.

        For a sender without numbers, only stamps detect repetitions.
        """
        if arrival.sender == self.commander:
            number, is_known = arrival.sequence, False
            if arrival.sender and number:
                is_known = not self._numbers.is_new(number, arrival.payload)
            if is_known or (number <= self._newest_sequence and self._newest_sequence):
                raise InvalidMessageError(
                    "replayed", "its number is not newer than that of the last command"
                )
        elif self.commander is not None and not self._has_left(self.commander):
            raise InvalidMessageError("other_commander", "another session is the commander")


def _given(target: NDArray[np.float64]) -> NDArray[np.float64] | None:
    """Return one or more targets for the drives; None if the sender gave none."""
    if np.isfinite(target).all():
        return target
    if np.isnan(target).all():
        return None
    raise InvalidMessageError("not_finite", "a target for the drives is not finite")
