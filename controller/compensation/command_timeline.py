"""Timeline of commands: which were sent, and when each comes into force."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from bus_schema.arrays import Matrix, Records, Vector, records
from bus_schema.runtime.compiled import assign, compiled
from controller.control_law import ABSENCE_STATES

CAPACITY = 8192
"""Commands remembered: all that can be in flight, even at 10 kHz."""
LONGEST_HORIZON_NS = 500_000_000
"""Limit of prediction, even if a plant reports longer delays."""
HELD = 0
"""Number that stands for no command: before the first one acts, brakes hold the arm."""
PIECES = 4
"""Of a bridge: torques and targets change linearly in each."""
_FOLLOW = 0.1
"""Share of a new observation in the horizon: jitter is averaged over about ten commands."""

_PATIENCE = 2.0
"""Time that a late command is waited for, in mean deviations of the horizon."""

GROWS_BY = 0.05
"""How fast an announced horizon grows towards the wanted one; commands act so much less often."""
_SHRINKS_IN_NS, _RETURNS_IN_NS = 5e9, 0.5e9
"""Time constants with which an announced horizon shrinks after commands came late, and with which
it returns to its usual limit."""
_EPISODE_NS = 20_000_000
"""Commands that come late for this long are no exception: they have a longer delay.

A horizon that jumps by a time leaves the arm without a new torque for just as long. After a burst
of states or commands that all arrive at one instant, the next ones are in time.
"""


class HorizonSettings(NamedTuple):
    """Settings of the horizon of commands: the time from a state until its command acts.

    Attributes:
        least_ns: the plant's own play-out time, if it has one.
        first_ns: the horizon at first.
        wanted_ns: of an announced horizon, the one to reach slowly and to keep.
        most_ns: of an announced horizon, the longest one for the sake of commands that come late
            now and then. Those that come late for long are waited for longer.
        grows_by: how fast it grows to the wanted one, as a share of the time.
        is_announced: each command says when it acts, and the plant holds it until then.
        reserve_ns: what is added to the largest delay that was reported.
        row_ticks: ticks from one row of a command to the next, of a bridge of `PIECES`; 0 for none.
        tick_ns: time from one state to the next.
        substeps: physics steps in that time; an announced horizon ends where one begins, as the
            plant acts in such steps.
        actuator_ns: dead time of the actuators, which is part of every horizon.
    """

    least_ns: int = 0
    first_ns: int = 0
    wanted_ns: int = 0
    most_ns: int = LONGEST_HORIZON_NS
    grows_by: float = GROWS_BY
    is_announced: bool = False
    reserve_ns: int = 0
    row_ticks: int = 0
    tick_ns: int = 1_000_000
    substeps: int = 1
    actuator_ns: int = 0

    @property
    def longest_step_ns(self) -> int:
        """Time between states above which some were absent."""
        return ABSENCE_STATES * self.tick_ns


_AS_REPORTED = HorizonSettings()


class CommandFeedback(NamedTuple):
    """A plant status's report about commands.

    Attributes:
        sequence: number of the command in force, `HELD` before the first.
        delay_ns: time from the state that this command answers until it came into force.
        arrival_ns: largest time from a state until the command that answers it arrived, of the
            commands since the last report; -1 for none.
    """

    sequence: int
    delay_ns: int
    arrival_ns: int = -1


class Commands(NamedTuple):
    """Commands sent, and the horizon at which they act, for compiled code.

    A command's index is its number % `CAPACITY`.

    Attributes:
        numbers: shape (CAPACITY,); `HELD` for none.
        stamps_ns: stamp of the state that each command answers, shape (CAPACITY,).
        torques_nm: shape (CAPACITY, joints).
        targets: for the drives: position as of that stamp, rad, and velocity, rad/s, as rows;
            shape (CAPACITY, 2, joints).
        announced_ns: time after that stamp at which the command says that it acts, shape
            (CAPACITY,); 0 for on arrival.
        plans: torque, target position and velocity at the ends of the bridge's pieces, for their
            change since the first row; shape (CAPACITY, ends, 3, joints).
        next_plan: that of the command to be noted next.
        state: one row, `HorizonSettings` and what changes. `horizon_ns`: time from a state until
            its torque acts, expected from `mean_delay_ns` and `spread_ns`, or announced;
            `exact_ns`: the latter before rounding; `longest_ns`: what late commands needed, slowly
            forgotten; `late_since_ns`: stamp of the state since which all reported commands came
            late, -1 for none; `first` and `newest`: numbers of commands; `in_force`: the one that
            the plant reported last.
    """

    numbers: NDArray[np.int64]
    stamps_ns: NDArray[np.int64]
    torques_nm: Matrix
    targets: NDArray[np.float64]
    announced_ns: NDArray[np.int64]
    plans: NDArray[np.float64]
    next_plan: NDArray[np.float64]
    state: Records


class Flight(NamedTuple):
    """Commands that act from an instant on.

    Attributes:
        in_force: number of the command in force at first.
        upcoming: number of the command that acts next.
        newest: number of the last command.
        delay_ns: time from a command's stamp until it comes into force, if it announces no longer
            one.
    """

    in_force: int
    upcoming: int
    newest: int
    delay_ns: int


def no_commands(joints: int, settings: HorizonSettings = _AS_REPORTED) -> Commands:
    """Return an empty table of commands."""
    state = {
        **settings._asdict(), "horizon_ns": 0, "longest_ns": 0.0, "exact_ns": 0.0,
        "mean_delay_ns": 0.0, "spread_ns": 0.0, "late_since_ns": -1,
        "first": HELD, "newest": HELD, "in_force": HELD,
    }  # fmt: skip
    ends = PIECES + 1 if settings.row_ticks else 0
    commands = Commands(
        np.zeros(CAPACITY, np.int64), np.zeros(CAPACITY, np.int64), np.zeros((CAPACITY, joints)),
        np.zeros((CAPACITY, 2, joints)), np.zeros(CAPACITY, np.int64),
        np.zeros((CAPACITY, ends, 3, joints)), np.zeros((ends, 3, joints)), records(1, state),
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
    state.late_since_ns = -1
    state.longest_ns, state.exact_ns = 0.0, float(state.first_ns)
    _expect(state, state.first_ns)


@compiled
def note(commands: Commands, torque_nm: Vector, target: Matrix, number: int, stamp_ns: int) -> None:
    """Note a command that was sent, with a number above all before; see `Commands`."""
    slot, state = number % CAPACITY, commands.state[0]
    commands.numbers[slot], commands.stamps_ns[slot] = number, stamp_ns
    assign(commands.torques_nm[slot], torque_nm)
    assign(commands.targets[slot], target)
    commands.announced_ns[slot] = state.horizon_ns if state.is_announced else 0
    if state.row_ticks > 0:
        assign(commands.plans[slot], commands.next_plan)
    first = number if state.first == HELD else state.first
    state.first = max(first, number - CAPACITY + 1)
    state.newest = number


@compiled
def command_at(commands: Commands, slot: int, now_ns: int, values: Matrix) -> float:
    """Write torque, target position and velocity of a command in force, shape (3, joints).

    Returns:
        The target's age, s.
    """
    for i in range(values.shape[1]):
        values[0, i] = commands.torques_nm[slot, i]
        values[1, i], values[2, i] = commands.targets[slot, 0, i], commands.targets[slot, 1, i]
    age_ns = now_ns - commands.stamps_ns[slot]
    if len(commands.next_plan) > 0:
        state = commands.state[0]
        tick = max(0, (age_ns - commands.announced_ns[slot]) // state.tick_ns)
        tick = min(tick, PIECES * state.row_ticks)
        piece = min(tick // state.row_ticks, PIECES - 1)
        share = tick / state.row_ticks - piece
        add_change(commands.plans[slot], piece, share, values)
        age_ns -= tick * state.tick_ns
    return age_ns * 1e-9  # type: ignore[no-any-return]


@compiled
def add_change(plan: NDArray[np.float64], piece: int, share: float, values: Matrix) -> None:
    """Add the change until a share of a piece to torque, target position and velocity.

    Args:
        plan: of a command, see `Commands.plans`.
        piece: its number, from 0 on.
        share: what has passed of it, from 0 to 1.
        values: changed in place, shape (3, joints).
    """
    for what in range(3):
        for i in range(values.shape[1]):
            begin, end = plan[piece, what, i], plan[piece + 1, what, i]
            values[what, i] += begin + share * (end - begin) - plan[0, what, i]


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
def observe(commands: Commands, feedback: CommandFeedback, now_ns: int, last_ns: int) -> None:
    """Learn the horizon from the feedback of a state.

    Args:
        commands: all that were sent.
        feedback: a plausible one.
        now_ns: stamp of the state.
        last_ns: stamp of the state before.
    """
    sequence, delay_ns, arrival_ns = feedback
    state = commands.state[0]
    if not state.is_announced:
        _follow_delay(commands, sequence, delay_ns, now_ns)
    else:
        late_ns = 0
        if sequence != state.in_force and delay_ns > commands.announced_ns[sequence % CAPACITY]:
            late_ns = delay_ns
            arrival_ns = max(arrival_ns, late_ns)
        arrival_ns = min(arrival_ns, now_ns - commands.stamps_ns[state.first % CAPACITY])
        if sequence == HELD and state.wanted_ns == state.actuator_ns and state.first != HELD:
            # Nothing acts yet, so the first command has been on its way for at least this long.
            waited_ns = now_ns - commands.stamps_ns[state.first % CAPACITY]
            state.exact_ns = max(state.exact_ns, float(waited_ns))
        _announce(commands, arrival_ns, late_ns, now_ns, now_ns - last_ns)
    state.in_force = sequence


@compiled
def _follow_delay(commands: Commands, sequence: int, delay_ns: int, now_ns: int) -> None:
    """Follow the reported delays with the expected one."""
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


@compiled
def _announce(
    commands: Commands, arrival_ns: int, late_ns: int, now_ns: int, step_ns: int
) -> None:  # fmt: skip
    """Choose the horizon to announce, after a state reported how long commands take to arrive.

    It grows at once to what the command in force needed if that came late, but only for an episode
    of late commands above its usual limit; by a tick if only others came late, as in a burst that
    arrives at one instant; and slowly towards the wanted one. It shrinks slowly to what arrivals
    need, but not below the wanted one.

    Args:
        commands: all that were sent.
        arrival_ns: as in `CommandFeedback`.
        late_ns: time that the command in force took, if it is new and came late; else 0.
        now_ns: stamp of the state.
        step_ns: time since the last state.
    """
    state = commands.state[0]
    if arrival_ns >= 0:
        is_first = state.mean_delay_ns == 0.0
        surprise_ns = arrival_ns - state.mean_delay_ns
        state.mean_delay_ns += surprise_ns if is_first else _FOLLOW * surprise_ns
        if not is_first:
            state.spread_ns += _FOLLOW * (abs(surprise_ns) - state.spread_ns)
        if arrival_ns <= state.horizon_ns:
            state.late_since_ns = -1
        elif state.late_since_ns < 0:
            state.late_since_ns = now_ns
    needed_ns = late_ns + state.reserve_ns
    if late_ns <= state.horizon_ns:
        needed_ns = min(arrival_ns + state.reserve_ns, state.horizon_ns + state.tick_ns)
    if state.late_since_ns < 0 or now_ns - state.late_since_ns < _EPISODE_NS:
        needed_ns = min(needed_ns, state.most_ns)
    excess_ns = max(0.0, state.longest_ns - state.mean_delay_ns)
    shrinks_in_ns = _RETURNS_IN_NS if state.longest_ns > state.most_ns else _SHRINKS_IN_NS
    state.longest_ns -= excess_ns * min(1.0, step_ns / shrinks_in_ns)
    if arrival_ns > state.wanted_ns:
        state.longest_ns = max(state.longest_ns, needed_ns)
    exact_ns = state.exact_ns
    if arrival_ns > state.horizon_ns:
        exact_ns = max(exact_ns, needed_ns)
    elif exact_ns < state.wanted_ns:
        exact_ns = min(exact_ns + state.grows_by * step_ns, state.wanted_ns)
    else:
        exact_ns = min(exact_ns, max(state.wanted_ns, state.longest_ns))
    state.exact_ns = exact_ns
    steps = math.ceil(exact_ns * state.substeps / state.tick_ns)
    _expect(state, int(steps) * state.tick_ns // state.substeps)


@compiled
def schedule(commands: Commands, in_force: int, newest: int, delay_ns: int, from_ns: int) -> Flight:
    """Return which commands act from an instant on, if each up to `newest` takes this delay."""
    upcoming = max(in_force + 1, commands.state[0].first)
    while upcoming <= newest and acts_ns(commands, upcoming % CAPACITY, delay_ns) < from_ns:
        upcoming += 1
    return Flight(in_force, upcoming, newest, delay_ns)


@compiled
def acts_ns(commands: Commands, slot: int, delay_ns: int) -> int:
    """Return when a command comes into force, if it takes this delay."""
    return commands.stamps_ns[slot] + max(delay_ns, commands.announced_ns[slot])  # type: ignore[no-any-return]


@compiled
def ahead(commands: Commands, in_force: int, now_ns: int) -> Flight:
    """Return which commands will act from now on.

    An overdue command is expected immediately; overdue by more than the horizon's usual variation,
    it counts as lost.
    """
    state = commands.state[0]
    patience_ns = int(np.rint(_PATIENCE * state.spread_ns))
    delay_ns = 0 if state.is_announced else state.horizon_ns
    return schedule(commands, in_force, state.newest, delay_ns, now_ns - patience_ns)


@compiled
def assumed_in_force(commands: Commands, now_ns: int) -> int:
    """Return, without feedback, the command that should have come into force before now."""
    state = commands.state[0]
    return schedule(commands, HELD, state.newest, state.horizon_ns, now_ns).upcoming - 1


@compiled
def _expect(state: Any, horizon_ns: int) -> None:
    state.horizon_ns = min(max(horizon_ns, state.least_ns), LONGEST_HORIZON_NS)
