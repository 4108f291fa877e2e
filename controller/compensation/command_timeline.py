"""Timeline of commands: which were sent, and when each comes into force."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from bus_schema.arrays import Matrix, Records, Vector, records
from bus_schema.runtime.compiled import compiled

CAPACITY = 8192
"""Commands remembered: all that can be in flight, even at 10 kHz."""
LONGEST_HORIZON_NS = 500_000_000
"""Limit of prediction, even if a plant reports longer delays."""
HELD = 0
"""Number that stands for no command: before the first one acts, brakes hold the arm."""
_FOLLOW = 0.1
"""Share of a new observation in the horizon: jitter is averaged over about ten commands."""

_PATIENCE = 2.0
"""Time that a late command is waited for, in mean deviations of the horizon."""


class CommandFeedback(NamedTuple):
    """A plant status's report about commands.

    Attributes:
        sequence: number of the command in force, `HELD` before the first.
        delay_ns: time from the state that this command answers until it came into force.
    """

    sequence: int
    delay_ns: int


class Commands(NamedTuple):
    """Commands sent, and the horizon at which they act, for compiled code.

    A command's index is its number % `CAPACITY`.

    Attributes:
        numbers: shape (CAPACITY,); `HELD` for none.
        stamps_ns: stamp of the state that each command answers, shape (CAPACITY,).
        torques_nm: shape (CAPACITY, joints).
        targets: for the drives: position as of that stamp, rad, and velocity, rad/s, as rows;
            shape (CAPACITY, 2, joints).
        state: one row. `least_horizon_ns`: shortest time from a state until the torque that answers
            it acts; `first_horizon_ns`: assumed horizon until a command has come into force;
            `horizon_ns`: expected time from a state until its torque acts, from `mean_delay_ns` and
            `spread_ns`; `first` and `newest`: numbers of commands; `in_force`: the one that the
            plant reported last.
    """

    numbers: NDArray[np.int64]
    stamps_ns: NDArray[np.int64]
    torques_nm: Matrix
    targets: NDArray[np.float64]
    state: Records


class Flight(NamedTuple):
    """Commands that act from an instant on.

    Attributes:
        in_force: number of the command in force at first.
        upcoming: number of the command that acts next.
        newest: number of the last command.
        delay_ns: time from a command's stamp until it comes into force.
    """

    in_force: int
    upcoming: int
    newest: int
    delay_ns: int


def no_commands(joints: int, least_horizon_ns: int, first_horizon_ns: int = 0) -> Commands:
    """Return an empty table of commands; horizons as in `Commands.state`."""
    state = {
        "least_horizon_ns": least_horizon_ns, "first_horizon_ns": first_horizon_ns,
        "horizon_ns": 0, "mean_delay_ns": 0.0, "spread_ns": 0.0, "first": HELD, "newest": HELD,
        "in_force": HELD,
    }  # fmt: skip
    commands = Commands(
        np.zeros(CAPACITY, np.int64), np.zeros(CAPACITY, np.int64), np.zeros((CAPACITY, joints)),
        np.zeros((CAPACITY, 2, joints)), records(1, state),
    )  # fmt: skip
    forget_commands(commands)
    return commands


@compiled
def forget_commands(commands: Commands) -> None:
    """Forget all commands."""
    state = commands.state[0]
    commands.numbers[:] = HELD
    state.first = state.newest = state.in_force = HELD
    state.mean_delay_ns = state.spread_ns = 0.0
    _expect(state, state.first_horizon_ns)


@compiled
def note(commands: Commands, torque_nm: Vector, target: Matrix, number: int, stamp_ns: int) -> None:
    """Note a command that was sent, with a number above all before; see `Commands`."""
    slot, state = number % CAPACITY, commands.state[0]
    commands.numbers[slot], commands.stamps_ns[slot] = number, stamp_ns
    commands.torques_nm[slot] = torque_nm
    commands.targets[slot] = target
    first = number if state.first == HELD else state.first
    state.first = max(first, number - CAPACITY + 1)
    state.newest = number


@compiled
def explains(commands: Commands, sequence: int, delay_ns: int, now_ns: int) -> bool:
    """Whether this feedback is plausible for a state that left the plant at `now_ns`."""
    slot = sequence % CAPACITY
    return bool(
        sequence == HELD
        or (
            commands.numbers[slot] == sequence
            and 0 <= delay_ns <= now_ns - commands.stamps_ns[slot]
        )
    )


@compiled
def observe_delay(commands: Commands, sequence: int, delay_ns: int, now_ns: int) -> None:
    """Learn the horizon from the feedback of a state that left the plant at `now_ns`."""
    state = commands.state[0]
    if sequence == HELD:
        # Nothing acts yet, so the first command has been on its way for at least this long.
        waited_ns = 0
        if state.first != HELD:
            waited_ns = now_ns - commands.stamps_ns[state.first % CAPACITY]
        _expect(state, max(state.horizon_ns, waited_ns))
    elif sequence != state.in_force:
        share = _FOLLOW if state.in_force != HELD else 1.0
        surprise_ns = delay_ns - state.mean_delay_ns
        state.mean_delay_ns += share * surprise_ns
        if state.in_force != HELD:
            state.spread_ns += share * (abs(surprise_ns) - state.spread_ns)
        _expect(state, int(np.rint(state.mean_delay_ns)))
    state.in_force = sequence


@compiled
def schedule(commands: Commands, in_force: int, newest: int, delay_ns: int, from_ns: int) -> Flight:
    """Return which commands act from an instant on, if each up to `newest` takes this delay."""
    upcoming = max(in_force + 1, commands.state[0].first)
    since_ns = from_ns - delay_ns
    while upcoming <= newest and commands.stamps_ns[upcoming % CAPACITY] < since_ns:
        upcoming += 1
    return Flight(in_force, upcoming, newest, delay_ns)


@compiled
def ahead(commands: Commands, in_force: int, now_ns: int) -> Flight:
    """Return which commands will act from now on.

    An overdue command is expected immediately; overdue by more than the horizon's usual variation,
    it counts as lost.
    """
    state = commands.state[0]
    patience_ns = int(np.rint(_PATIENCE * state.spread_ns))
    return schedule(commands, in_force, state.newest, state.horizon_ns, now_ns - patience_ns)


@compiled
def assumed_in_force(commands: Commands, now_ns: int) -> int:
    """Return, without feedback, the command that should have come into force before now."""
    state = commands.state[0]
    return schedule(commands, HELD, state.newest, state.horizon_ns, now_ns).upcoming - 1


@compiled
def _expect(state: Any, horizon_ns: int) -> None:
    state.horizon_ns = min(max(horizon_ns, state.least_horizon_ns), LONGEST_HORIZON_NS)
