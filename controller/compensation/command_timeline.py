"""Which torque acts when: the commands that were sent, and how long they take to act."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from bus_schema.arrays import Matrix, Vector
from bus_schema.runtime.compiled import compiled

CAPACITY = 8192
"""Commands remembered: all that can be in flight, even at 10 kHz."""
LONGEST_HORIZON_NS = 500_000_000
"""No prediction reaches further, whatever a plant says of its delays."""
HELD = 0
"""Number of no command: before the first one acts, brakes hold the arm."""
_FOLLOW = 0.1
"""Share of a new observation in the horizon: jitter is averaged over about ten commands."""

_PATIENCE = 2.0
"""A command is waited for beyond its time, in mean deviations of the horizon."""


class CommandFeedback(NamedTuple):
    """What a plant status says about commands.

    Attributes:
        sequence: number of the command in force, `HELD` before the first.
        delay_ns: from the state which that command answers to its coming into force.
    """

    sequence: int
    delay_ns: int


class Commands(NamedTuple):
    """The commands sent, for compiled code; a command's place is its number % `CAPACITY`.

    Attributes:
        stamps_ns: stamp of the state that each command answers, shape (CAPACITY,).
        torques_nm: shape (CAPACITY, joints).
        targets: for the drives: position as of that stamp, rad, and velocity, rad/s, as rows;
            shape (CAPACITY, 2, joints).
    """

    stamps_ns: NDArray[np.int64]
    torques_nm: Matrix
    targets: NDArray[np.float64]


class Flight(NamedTuple):
    """Which commands act from an instant on.

    Attributes:
        in_force: number of the command in force at first.
        upcoming: number of the command that acts next.
        newest: number of the last command.
        delay_ns: from a command's stamp to its coming into force.
    """

    in_force: int
    upcoming: int
    newest: int
    delay_ns: int


class CommandTimeline:
    """The commands a controller sent, and the horizon at which they act.

    Args:
        joints: number of joints.
        least_horizon_ns: no torque acts sooner than this after the state it answers.
        first_horizon_ns: what the horizon is taken for until a command has come into force.

    Attributes:
        commands: all that can be in flight.
        horizon_ns: expected time from a state to the acting of the torque that answers it.
    """

    def __init__(self, joints: int, least_horizon_ns: int, first_horizon_ns: int = 0) -> None:
        self._least_horizon_ns, self._first_horizon_ns = least_horizon_ns, first_horizon_ns
        self.commands = Commands(
            np.zeros(CAPACITY, dtype=np.int64),
            np.zeros((CAPACITY, joints)),
            np.zeros((CAPACITY, 2, joints)),
        )
        self._stamps_ns = self.commands.stamps_ns
        self._numbers = np.zeros(CAPACITY, dtype=np.int64)
        self.reset()

    def reset(self) -> None:
        """Forget all commands."""
        self._numbers[:] = HELD
        self._first, self._newest = HELD, HELD
        self._in_force, self._mean_delay_ns, self._spread_ns = HELD, 0.0, 0.0
        self._expect(self._first_horizon_ns)

    def note(
        self, number: int, stamp_ns: int, torque_nm: Vector, target: Matrix | None = None
    ) -> None:
        """A command was sent, whose number is above those of all before; see `Commands`."""
        slot = number % CAPACITY
        self._numbers[slot], self._stamps_ns[slot] = number, stamp_ns
        self.commands.torques_nm[slot] = torque_nm
        if target is not None:
            self.commands.targets[slot] = target
        self._first = max(self._first or number, number - CAPACITY + 1)
        self._newest = number

    def explains(self, feedback: CommandFeedback, now_ns: int) -> bool:
        """Whether a state that left the plant at `now_ns` can bear this feedback."""
        slot = feedback.sequence % CAPACITY
        return feedback.sequence == HELD or (
            int(self._numbers[slot]) == feedback.sequence
            and 0 <= feedback.delay_ns <= now_ns - int(self._stamps_ns[slot])
        )

    def observe(self, feedback: CommandFeedback, now_ns: int) -> None:
        """Learn the horizon from a state that left the plant at `now_ns`."""
        if feedback.sequence == HELD:
            # Nothing acts yet, so the first command has been on its way for at least as long.
            waited_ns = now_ns - int(self._stamps_ns[self._first % CAPACITY]) if self._first else 0
            self._expect(max(self.horizon_ns, waited_ns))
        elif feedback.sequence != self._in_force:
            share = _FOLLOW if self._in_force != HELD else 1.0
            surprise_ns = feedback.delay_ns - self._mean_delay_ns
            self._mean_delay_ns += share * surprise_ns
            if self._in_force != HELD:
                self._spread_ns += share * (abs(surprise_ns) - self._spread_ns)
            self._expect(round(self._mean_delay_ns))
        self._in_force = feedback.sequence

    def between(self, in_force: int, then: CommandFeedback, from_ns: int) -> Flight:
        """What acted from an instant on, while the command in force gave way to another one."""
        return self._schedule(in_force, then.sequence, then.delay_ns, from_ns)

    def ahead(self, in_force: int, now_ns: int) -> Flight:
        """What will act from now on.

        A command that should have come by now is just about to, or it is lost if it is overdue by
        more than the horizon's usual variation.
        """
        patience_ns = round(_PATIENCE * self._spread_ns)
        return self._schedule(in_force, self._newest, self.horizon_ns, now_ns - patience_ns)

    def assumed_in_force(self, now_ns: int) -> int:
        """The command that should have come into force before now, for want of feedback."""
        return self._schedule(HELD, self._newest, self.horizon_ns, now_ns).upcoming - 1

    def _expect(self, horizon_ns: int) -> None:
        self.horizon_ns = min(max(horizon_ns, self._least_horizon_ns), LONGEST_HORIZON_NS)

    def _schedule(self, in_force: int, newest: int, delay_ns: int, from_ns: int) -> Flight:
        upcoming = _first_after(
            self._stamps_ns, max(in_force + 1, self._first), newest, from_ns - delay_ns
        )
        return Flight(in_force, upcoming, newest, delay_ns)


@compiled
def _first_after(stamps_ns: NDArray[np.int64], number: int, newest: int, since_ns: int) -> int:
    """The first command from `number` on that answers a state since an instant."""
    while number <= newest and stamps_ns[number % stamps_ns.size] < since_ns:
        number += 1
    return number
