"""The power drive system's finite state automaton of CiA 402-2 (IEC 61800-7-201).

Transitions are numbered as in the standard:

== ============================================ ===============================================
0  start → not ready to switch on               power on, reset
1  not ready to switch on → switch on disabled  self-test passed
2  switch on disabled → ready to switch on      shutdown
3  ready to switch on → switched on             switch on (with enable operation: 4 follows)
4  switched on → operation enabled              enable operation
5  operation enabled → switched on              disable operation
6  switched on → ready to switch on             shutdown
7  ready to switch on → switch on disabled      quick stop or disable voltage
8  operation enabled → ready to switch on       shutdown
9  operation enabled → switch on disabled       disable voltage
10 switched on → switch on disabled             disable voltage or quick stop
11 operation enabled → quick stop active        quick stop
12 quick stop active → switch on disabled       quick stop done, or disable voltage
13 any → fault reaction active                  fault
14 fault reaction active → fault                fault reaction done
15 fault → switch on disabled                   fault reset
16 quick stop active → operation enabled        enable operation, if the drive stays in quick stop
== ============================================ ===============================================
"""

from __future__ import annotations

from collections.abc import Callable
from enum import IntEnum, auto
from typing import NamedTuple

from plant_emulator.drives.cia402.node import DriveNode


class State(IntEnum):
    """States, and the bits of the statusword that name each."""

    NOT_READY_TO_SWITCH_ON = 0x00
    SWITCH_ON_DISABLED = 0x40
    READY_TO_SWITCH_ON = 0x21
    SWITCHED_ON = 0x23
    OPERATION_ENABLED = 0x27
    QUICK_STOP_ACTIVE = 0x07
    FAULT_REACTION_ACTIVE = 0x0F
    FAULT = 0x08


class ControlCommand(IntEnum):
    """Commands of the controlword."""

    SHUTDOWN = auto()
    SWITCH_ON = auto()
    ENABLE_OPERATION = auto()
    DISABLE_VOLTAGE = auto()
    QUICK_STOP = auto()
    FAULT_RESET = auto()


class Controlword:
    """Bits of object 0x6040."""

    SWITCH_ON = 1 << 0
    ENABLE_VOLTAGE = 1 << 1
    QUICK_STOP = 1 << 2
    ENABLE_OPERATION = 1 << 3
    FAULT_RESET = 1 << 7
    HALT = 1 << 8


class Statusword:
    """Bits of object 0x6041 beside those that name the state (0, 1, 2, 3, 5, 6)."""

    VOLTAGE_ENABLED = 1 << 4
    WARNING = 1 << 7
    REMOTE = 1 << 9
    INTERNAL_LIMIT_ACTIVE = 1 << 11
    FOLLOWS_COMMAND = 1 << 12
    FOLLOWING_ERROR = 1 << 13


_S, _C = State, ControlCommand
TRANSITIONS: dict[tuple[State, ControlCommand], State] = {
    (_S.SWITCH_ON_DISABLED, _C.SHUTDOWN): _S.READY_TO_SWITCH_ON,  # 2
    (_S.READY_TO_SWITCH_ON, _C.SWITCH_ON): _S.SWITCHED_ON,  # 3
    (_S.READY_TO_SWITCH_ON, _C.ENABLE_OPERATION): _S.OPERATION_ENABLED,  # 3, then 4 by itself
    (_S.SWITCHED_ON, _C.ENABLE_OPERATION): _S.OPERATION_ENABLED,  # 4
    (_S.OPERATION_ENABLED, _C.SWITCH_ON): _S.SWITCHED_ON,  # 5: disable operation
    (_S.SWITCHED_ON, _C.SHUTDOWN): _S.READY_TO_SWITCH_ON,  # 6
    (_S.READY_TO_SWITCH_ON, _C.QUICK_STOP): _S.SWITCH_ON_DISABLED,  # 7
    (_S.READY_TO_SWITCH_ON, _C.DISABLE_VOLTAGE): _S.SWITCH_ON_DISABLED,  # 7
    (_S.OPERATION_ENABLED, _C.SHUTDOWN): _S.READY_TO_SWITCH_ON,  # 8
    (_S.OPERATION_ENABLED, _C.DISABLE_VOLTAGE): _S.SWITCH_ON_DISABLED,  # 9
    (_S.SWITCHED_ON, _C.DISABLE_VOLTAGE): _S.SWITCH_ON_DISABLED,  # 10
    (_S.SWITCHED_ON, _C.QUICK_STOP): _S.SWITCH_ON_DISABLED,  # 10
    (_S.OPERATION_ENABLED, _C.QUICK_STOP): _S.QUICK_STOP_ACTIVE,  # 11
    (_S.QUICK_STOP_ACTIVE, _C.DISABLE_VOLTAGE): _S.SWITCH_ON_DISABLED,  # 12
    (_S.FAULT, _C.FAULT_RESET): _S.SWITCH_ON_DISABLED,  # 15
    (_S.QUICK_STOP_ACTIVE, _C.ENABLE_OPERATION): _S.OPERATION_ENABLED,  # 16
}
"""Transitions by state and command; all other commands have no effect."""


def decode_command(controlword: int, previous: int) -> ControlCommand | None:
    """The command in a controlword (CiA 402-2, command coding), None if it codes none.

    Args:
        controlword: the word.
        previous: the word before it: a fault reset is a rising edge.
    """
    if controlword & Controlword.FAULT_RESET:
        return None if previous & Controlword.FAULT_RESET else ControlCommand.FAULT_RESET
    return _COMMANDS[controlword & _COMMAND_BITS]


_COMMAND_WITHOUT = {
    Controlword.ENABLE_VOLTAGE: ControlCommand.DISABLE_VOLTAGE,
    Controlword.QUICK_STOP: ControlCommand.QUICK_STOP,
    Controlword.SWITCH_ON: ControlCommand.SHUTDOWN,
    Controlword.ENABLE_OPERATION: ControlCommand.SWITCH_ON,
}
"""Request of a controlword, by the first of these bits that it lacks."""

_COMMAND_BITS = sum(_COMMAND_WITHOUT)
_COMMANDS = [
    next(
        (command for bit, command in _COMMAND_WITHOUT.items() if not word & bit),
        _C.ENABLE_OPERATION,
    )
    for word in range(_COMMAND_BITS + 1)
]

_MS = 1_000_000
_QUICK_STOP, _FAULT_REACTION = 0x605A_00, 0x605E_00
_SLOW_DOWN_OPTIONS = {ControlCommand.SHUTDOWN: 0x605B_00, ControlCommand.SWITCH_ON: 0x605C_00}
_LONGEST_SLOW_DOWN = 0x2000_00
_STAYS_IN_QUICK_STOP = (5, 6, 7, 8)
_POWER_OFF = 0


class _SlowDown(NamedTuple):
    """The motor slows the joint down to a halt.

    Attributes:
        then: state that follows.
        until_ns: latest time of its end.
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
        """Reset to the state before power-on."""
        self._enter(State.NOT_READY_TO_SWITCH_ON)

    def obey(self, controlword: int) -> None:
        """Process a controlword."""
        command = decode_command(controlword, self._controlword)
        self._controlword = controlword
        self.halted = bool(controlword & Controlword.HALT)
        if command is not None:
            self.command(command)

    def command(self, command: ControlCommand) -> None:
        """Make the transition for a command, if the standard has one."""
        if self.state is State.OPERATION_ENABLED and command is ControlCommand.ENABLE_OPERATION:
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
        if was_moving and not power_off and self._node.values[_FAULT_REACTION] != _POWER_OFF:
            self._begin_slow_down(State.FAULT)
        else:
            self._enter(State.FAULT)

    def advance(self) -> None:
        """End a slow-down whose time has come."""
        slow_down = self._slow_down
        if slow_down is not None and (self._is_still() or self._node.now_ns >= slow_down.until_ns):
            self._enter(slow_down.then)

    def _go(self, command: ControlCommand, following: State) -> None:
        was_enabled = self.state is State.OPERATION_ENABLED
        if command is ControlCommand.FAULT_RESET:
            if self._reset_errors():
                self._enter(following)
        elif command is ControlCommand.QUICK_STOP and was_enabled:
            self._quick_stop()
        elif following is State.OPERATION_ENABLED and self.state is State.QUICK_STOP_ACTIVE:
            if self._node.values[_QUICK_STOP] in _STAYS_IN_QUICK_STOP:  # else 16 is not possible
                self._enter(following)
        elif was_enabled and self._slows_down_for(command):
            if self._slow_down is None or self._slow_down.then is not following:
                self._begin_slow_down(following)
        else:
            self._enter(following)

    def _slows_down_for(self, command: ControlCommand) -> bool:
        """Whether an option code wants the joint at rest before the drive function ends."""
        option = _SLOW_DOWN_OPTIONS.get(command)
        return option is not None and self._node.values[option] != _POWER_OFF

    def _quick_stop(self) -> None:
        option = self._node.values[_QUICK_STOP]
        if option == _POWER_OFF:
            self._enter(State.SWITCH_ON_DISABLED)
            return
        self.state = State.QUICK_STOP_ACTIVE
        stays = option in _STAYS_IN_QUICK_STOP
        self._begin_slow_down(State.QUICK_STOP_ACTIVE if stays else State.SWITCH_ON_DISABLED)

    def _begin_slow_down(self, then: State) -> None:
        until_ns = self._node.now_ns + self._node.values[_LONGEST_SLOW_DOWN] * _MS
        self._slow_down = _SlowDown(then, until_ns)

    def _enter(self, state: State) -> None:
        self.state = state
        self._slow_down = None
