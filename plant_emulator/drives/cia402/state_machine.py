"""The power drive system's finite state automaton of CiA 402-2 (IEC 61800-7-201), and nothing else.

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

from enum import IntEnum, auto


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


class Command(IntEnum):
    """What a controlword asks for."""

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


_S, _C = State, Command
TRANSITIONS: dict[tuple[State, Command], State] = {
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
"""What a command does in a state; whatever is not here, does nothing."""


def decode_command(controlword: int, previous: int) -> Command | None:
    """The command in a controlword (CiA 402-2, command coding), None if it codes none.

    Args:
        controlword: the word.
        previous: the word before it: a fault reset is a rising edge.
    """
    if controlword & Controlword.FAULT_RESET:
        return None if previous & Controlword.FAULT_RESET else Command.FAULT_RESET
    return _COMMANDS[controlword & _COMMAND_BITS]


_COMMAND_WITHOUT = {
    Controlword.ENABLE_VOLTAGE: Command.DISABLE_VOLTAGE,
    Controlword.QUICK_STOP: Command.QUICK_STOP,
    Controlword.SWITCH_ON: Command.SHUTDOWN,
    Controlword.ENABLE_OPERATION: Command.SWITCH_ON,
}
"""What a controlword asks for by the first of these bits that it lacks."""

_COMMAND_BITS = sum(_COMMAND_WITHOUT)
_COMMANDS = [
    next(
        (command for bit, command in _COMMAND_WITHOUT.items() if not word & bit),
        _C.ENABLE_OPERATION,
    )
    for word in range(_COMMAND_BITS + 1)
]
