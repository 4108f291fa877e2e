"""The state machine against the table of IEC 61800-7-201 / CiA 402-2, clause "Power drive system
finite state automaton" (transitions 0 to 16, command coding, statusword coding)."""

import pytest
from drive_bench import (
    DISABLE_VOLTAGE,
    ENABLE,
    FAULT_RESET,
    QUICK_STOP,
    SHUTDOWN,
    SWITCH_ON,
    Bench,
)

from plant_emulator.drives.drive import DriveFault

COMMANDS = {
    "shutdown": SHUTDOWN, "switch on": SWITCH_ON, "enable operation": ENABLE,
    "disable voltage": DISABLE_VOLTAGE, "quick stop": QUICK_STOP, "fault reset": FAULT_RESET,
}  # fmt: skip
STATUSWORDS = {  # mask, value: CiA 402-2, table "State coding"
    "NOT_READY_TO_SWITCH_ON": (0x4F, 0x00),
    "SWITCH_ON_DISABLED": (0x4F, 0x40),
    "READY_TO_SWITCH_ON": (0x6F, 0x21),
    "SWITCHED_ON": (0x6F, 0x23),
    "OPERATION_ENABLED": (0x6F, 0x27),
    "QUICK_STOP_ACTIVE": (0x6F, 0x07),
    "FAULT_REACTION_ACTIVE": (0x4F, 0x0F),
    "FAULT": (0x4F, 0x08),
}
LEGAL = {  # (state, command): (number of the transition, next state)
    ("SWITCH_ON_DISABLED", "shutdown"): (2, "READY_TO_SWITCH_ON"),
    ("READY_TO_SWITCH_ON", "switch on"): (3, "SWITCHED_ON"),
    ("READY_TO_SWITCH_ON", "enable operation"): (3, "OPERATION_ENABLED"),  # 4 follows by itself
    ("SWITCHED_ON", "enable operation"): (4, "OPERATION_ENABLED"),
    ("OPERATION_ENABLED", "switch on"): (5, "SWITCHED_ON"),  # coded like disable operation
    ("SWITCHED_ON", "shutdown"): (6, "READY_TO_SWITCH_ON"),
    ("READY_TO_SWITCH_ON", "disable voltage"): (7, "SWITCH_ON_DISABLED"),
    ("READY_TO_SWITCH_ON", "quick stop"): (7, "SWITCH_ON_DISABLED"),
    ("OPERATION_ENABLED", "shutdown"): (8, "READY_TO_SWITCH_ON"),
    ("OPERATION_ENABLED", "disable voltage"): (9, "SWITCH_ON_DISABLED"),
    ("SWITCHED_ON", "disable voltage"): (10, "SWITCH_ON_DISABLED"),
    ("SWITCHED_ON", "quick stop"): (10, "SWITCH_ON_DISABLED"),
    ("OPERATION_ENABLED", "quick stop"): (11, "QUICK_STOP_ACTIVE"),
    ("QUICK_STOP_ACTIVE", "disable voltage"): (12, "SWITCH_ON_DISABLED"),
    ("FAULT", "fault reset"): (15, "SWITCH_ON_DISABLED"),
    ("QUICK_STOP_ACTIVE", "enable operation"): (16, "OPERATION_ENABLED"),
}
PATHS = {
    "SWITCH_ON_DISABLED": [],
    "READY_TO_SWITCH_ON": [SHUTDOWN],
    "SWITCHED_ON": [SHUTDOWN, SWITCH_ON],
    "OPERATION_ENABLED": [SHUTDOWN, SWITCH_ON, ENABLE],
    "QUICK_STOP_ACTIVE": [SHUTDOWN, SWITCH_ON, ENABLE, QUICK_STOP],
    "FAULT_REACTION_ACTIVE": [SHUTDOWN, SWITCH_ON, ENABLE],
    "FAULT": [],
}
QUICK_STOP_OPTION, SHUTDOWN_OPTION, DISABLE_OPTION, STAYS = 0x605A, 0x605B, 0x605C, 6


def reach(state):
    """A bench whose drive is in `state`; it stays in quick stop, and moves fast."""
    bench = Bench()
    bench.start()
    bench.write(QUICK_STOP_OPTION, 0, STAYS)
    bench.write(DISABLE_OPTION, 0, 0)
    bench.write(0x6060, 0, 10)
    bench.move(velocity_rad_s=3.0)
    for word in PATHS[state]:
        bench.control(word)
    if "FAULT" in state:
        bench.drive.inject(DriveFault.OVER_TEMPERATURE, bench.now_ns)
        bench.drive.clear(DriveFault.OVER_TEMPERATURE, bench.now_ns)
    assert bench.state == state
    return bench


@pytest.mark.parametrize("command", COMMANDS)
@pytest.mark.parametrize("state", PATHS)
def test_every_command_in_every_state(state, command):
    bench = reach(state)
    bench.control(COMMANDS[command])
    _, expected = LEGAL.get((state, command), (None, state))
    assert bench.state == expected
    mask, value = STATUSWORDS[expected]
    assert bench.statusword & mask == value


def test_transitions_0_and_1_are_made_at_power_on():
    bench = Bench(boot=False)
    assert bench.state == "NOT_READY_TO_SWITCH_ON"
    assert not bench.hear(0x600 + 5, 0x40, 0x41, 0x60, 0, 0, 0, 0, 0)  # it has not booted
    bench.wait(0)
    assert bench.state == "SWITCH_ON_DISABLED"


@pytest.mark.parametrize("state", ["SWITCH_ON_DISABLED", "READY_TO_SWITCH_ON", "SWITCHED_ON"])
def test_transitions_13_and_14_follow_each_other_where_nothing_moves(state):
    bench = reach(state)
    bench.drive.inject(DriveFault.OVER_TEMPERATURE, bench.now_ns)
    assert bench.state == "FAULT"


@pytest.mark.parametrize("state", ["OPERATION_ENABLED", "QUICK_STOP_ACTIVE"])
def test_transition_14_waits_for_the_reaction_to_end(state):
    bench = reach(state)
    bench.drive.inject(DriveFault.OVER_TEMPERATURE, bench.now_ns)
    bench.wait(50)
    assert bench.state == "FAULT_REACTION_ACTIVE"
    bench.move(velocity_rad_s=0.0)
    bench.wait(1)
    assert bench.state == "FAULT"


def test_fault_reset_is_a_rising_edge():
    bench = reach("SWITCH_ON_DISABLED")
    bench.control(FAULT_RESET)
    bench.drive.inject(DriveFault.DRIVE, bench.now_ns)
    bench.control(FAULT_RESET)  # the bit was set all the time
    assert bench.state == "FAULT"
    bench.control(0)
    bench.control(FAULT_RESET)
    assert bench.state == "SWITCH_ON_DISABLED"


@pytest.mark.parametrize(
    ("fault", "code"), [(DriveFault.OVER_TEMPERATURE, 0x4310), (DriveFault.ENCODER, 0x7305)]
)
def test_fault_reset_waits_for_the_cause_to_be_gone(fault, code):
    bench = reach("SWITCH_ON_DISABLED")
    bench.drive.inject(fault, bench.now_ns)
    bench.control(FAULT_RESET)
    assert bench.state == "FAULT"
    assert bench.read(0x603F) == code
    bench.drive.clear(fault, bench.now_ns)
    bench.control(0)
    bench.control(FAULT_RESET)
    assert bench.state == "SWITCH_ON_DISABLED"
    assert bench.read(0x603F) == 0


@pytest.mark.parametrize(
    ("word", "command"),
    [
        (0x0006, "shutdown"), (0xFF0E & ~0x80, "shutdown"), (0x0007, "switch on"),
        (0x0000, "disable voltage"), (0x000D, "disable voltage"), (0x0002, "quick stop"),
        (0x000B, "quick stop"), (0x000F, "enable operation"),
    ],
)  # fmt: skip
def test_only_the_bits_of_the_command_coding_count(word, command):
    """CiA 402-2, table "Command coding": bits marked x do not matter."""
    bench = reach("SWITCHED_ON")
    bench.control(word & ~0x100)
    assert bench.state == LEGAL.get(("SWITCHED_ON", command), (None, "SWITCHED_ON"))[1]


@pytest.mark.parametrize("option", range(9))
def test_quick_stop_option_code_decides_between_12_and_16(option):
    """0: power off at once; 1 to 4: slow down, then 12; 5 to 8: slow down and stay."""
    bench = reach("OPERATION_ENABLED")
    bench.write(QUICK_STOP_OPTION, 0, option)
    bench.control(QUICK_STOP)
    assert bench.state == ("SWITCH_ON_DISABLED" if option == 0 else "QUICK_STOP_ACTIVE")
    bench.move(velocity_rad_s=0.0)
    bench.wait(1)
    assert bench.state == ("QUICK_STOP_ACTIVE" if option >= 5 else "SWITCH_ON_DISABLED")
    bench.control(ENABLE)
    assert bench.state == ("OPERATION_ENABLED" if option >= 5 else "SWITCH_ON_DISABLED")
