"""The automaton at work: what its states do to the motor, and how it slows down between them."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

from plant_emulator.drives.cia402.node import DriveNode
from plant_emulator.drives.cia402.state_machine import (
    TRANSITIONS,
    Command,
    Controlword,
    State,
    decode_command,
)

_MS = 1_000_000
_QUICK_STOP, _FAULT_REACTION = 0x605A, 0x605E
_SLOW_DOWN_OPTIONS = {Command.SHUTDOWN: 0x605B, Command.SWITCH_ON: 0x605C}
_LONGEST_SLOW_DOWN = 0x2000
_STAYS_IN_QUICK_STOP = (5, 6, 7, 8)
_POWER_OFF = 0


class _SlowDown(NamedTuple):
    """The motor brings the joint to a halt.

    Attributes:
        then: state that follows.
        until_ns: time at which it ends at the latest.
    """

    then: State
    until_ns: int


class Automaton:
    """A drive's state, moved by controlwords, faults and time.

    Args:
        node: has the option codes.
        is_still: whether the joint is at rest.
        reset_errors: resets all errors; false while the cause of one is there.

    Attributes:
        state: as the statusword has it.
        halted: the controlword's halt bit is set.
    """

    def __init__(
        self, node: DriveNode, is_still: Callable[[], bool], reset_errors: Callable[[], bool]
    ) -> None:
        self._node, self._is_still, self._reset_errors = node, is_still, reset_errors
        self.state = State.NOT_READY_TO_SWITCH_ON
        self.halted = False
        self._controlword = 0
        self._slow_down: _SlowDown | None = None

    @property
    def follows(self) -> bool:
        """Whether the motor follows its target torque."""
        return self.state is State.OPERATION_ENABLED and self._slow_down is None and not self.halted

    @property
    def brings_to_rest(self) -> bool:
        """Whether the motor slows the joint down."""
        is_halting = self.halted and self.state is State.OPERATION_ENABLED and not self._is_still()
        return self._slow_down is not None or is_halting

    def power_on(self) -> None:
        """Transitions 0 and 1."""
        self._controlword = 0
        self.halted = False
        self._enter(State.SWITCH_ON_DISABLED)

    def power_off(self) -> None:
        """As before power-on."""
        self._enter(State.NOT_READY_TO_SWITCH_ON)

    def obey(self, controlword: int) -> None:
        """Take a controlword."""
        command = decode_command(controlword, self._controlword)
        self._controlword = controlword
        self.halted = bool(controlword & Controlword.HALT)
        if command is not None:
            self.command(command)

    def command(self, command: Command) -> None:
        """Make the transition that a command asks for, if the standard has one."""
        if self.state is State.OPERATION_ENABLED and command is Command.ENABLE_OPERATION:
            self._slow_down = None  # a slow-down to another state is called off
            return
        following = TRANSITIONS.get((self.state, command))
        if following is not None:
            self._go(command, following)

    def fault(self, *, power_off: bool = False) -> None:
        """Transition 13, and 14 as soon as the reaction is done.

        Args:
            power_off: the power stage cannot slow anything down.
        """
        if self.state in (State.FAULT, State.FAULT_REACTION_ACTIVE):
            if power_off:
                self._enter(State.FAULT)
            return
        was_moving = self.state is State.OPERATION_ENABLED or self._slow_down is not None
        self.state = State.FAULT_REACTION_ACTIVE
        if was_moving and not power_off and self._node.value(_FAULT_REACTION) != _POWER_OFF:
            self._begin_slow_down(State.FAULT)
        else:
            self._enter(State.FAULT)

    def advance(self) -> None:
        """End a slow-down whose time has come."""
        slow_down = self._slow_down
        if slow_down is not None and (self._is_still() or self._node.now_ns >= slow_down.until_ns):
            self._enter(slow_down.then)

    def _go(self, command: Command, following: State) -> None:
        was_enabled = self.state is State.OPERATION_ENABLED
        if command is Command.FAULT_RESET:
            if self._reset_errors():
                self._enter(following)
        elif command is Command.QUICK_STOP and was_enabled:
            self._quick_stop()
        elif following is State.OPERATION_ENABLED and self.state is State.QUICK_STOP_ACTIVE:
            if self._node.value(_QUICK_STOP) in _STAYS_IN_QUICK_STOP:  # else 16 is not possible
                self._enter(following)
        elif was_enabled and self._slows_down_for(command):
            if self._slow_down is None or self._slow_down.then is not following:
                self._begin_slow_down(following)
        else:
            self._enter(following)

    def _slows_down_for(self, command: Command) -> bool:
        """Whether an option code wants the joint at rest before the drive function ends."""
        option = _SLOW_DOWN_OPTIONS.get(command)
        return option is not None and self._node.value(option) != _POWER_OFF

    def _quick_stop(self) -> None:
        option = self._node.value(_QUICK_STOP)
        if option == _POWER_OFF:
            self._enter(State.SWITCH_ON_DISABLED)
            return
        self.state = State.QUICK_STOP_ACTIVE
        stays = option in _STAYS_IN_QUICK_STOP
        self._begin_slow_down(State.QUICK_STOP_ACTIVE if stays else State.SWITCH_ON_DISABLED)

    def _begin_slow_down(self, then: State) -> None:
        until_ns = self._node.now_ns + self._node.value(_LONGEST_SLOW_DOWN) * _MS
        self._slow_down = _SlowDown(then, until_ns)

    def _enter(self, state: State) -> None:
        self.state = state
        self._slow_down = None
