"""Effects of states, master and bus on the joint: torque, brake, slowing down."""

import pytest
from drive_bench import (
    ENABLE,
    FAULT_RESET,
    NODE,
    QUICK_STOP,
    SHUTDOWN,
    SWITCH_ON,
    Bench,
)

from plant_emulator.drives.drive import AT_REST, DriveFault

HALT = 0x10F
EMCY = 0x80 + NODE
MASTER = 0x7F
FAST_RAD_S = 2.0
DAMPING_NM = -20.0  # 10 N m s at 2 rad/s
TORQUE, TORQUE_NM = 500, 10.0  # half of 20 N m


@pytest.fixture
def enabled():
    bench = Bench()
    bench.enable(TORQUE)
    bench.move(velocity_rad_s=FAST_RAD_S)
    return bench


def code(data):
    return int.from_bytes(data[:2], "little")


def test_the_brake_holds_until_the_drive_function_is_enabled():
    bench = Bench()
    bench.start()
    bench.write(0x6060, 0, 10)
    for word in (SHUTDOWN, SWITCH_ON):
        bench.control(word, TORQUE)
        assert bench.drive.demand() == AT_REST
    bench.control(ENABLE, TORQUE)
    assert bench.drive.demand()[:2] == (TORQUE_NM, True)


def test_without_a_mode_there_is_no_torque():
    bench = Bench()
    bench.start()
    for word in (SHUTDOWN, SWITCH_ON, ENABLE):
        bench.control(word, TORQUE)
    assert bench.state == "OPERATION_ENABLED"
    assert bench.drive.demand() == AT_REST
    assert not bench.statusword & 1 << 12


@pytest.mark.parametrize(
    ("option", "value", "word", "then"),
    [
        (0x605B, 1, SHUTDOWN, "READY_TO_SWITCH_ON"),
        (0x605C, 1, SWITCH_ON, "SWITCHED_ON"),
    ],
)
def test_option_codes_slow_the_joint_down_before_the_state_changes(
    enabled, option, value, word, then
):
    enabled.write(option, 0, value)
    for _ in range(20):  # a cyclic master repeats itself
        enabled.control(word, TORQUE)
        enabled.wait(1)
    assert enabled.state == "OPERATION_ENABLED"
    assert enabled.drive.demand()[:2] == (DAMPING_NM, True)
    enabled.move()
    enabled.wait(1)
    assert enabled.state == then
    assert enabled.drive.demand() == AT_REST


def test_a_slow_down_ends_after_its_longest_time(enabled):
    enabled.write(0x2000, 0, 100)
    enabled.control(QUICK_STOP)
    for _ in range(99):
        enabled.control(QUICK_STOP)
        enabled.wait(1)
    assert enabled.drive.demand().is_released
    enabled.wait(1)
    assert enabled.state == "SWITCH_ON_DISABLED"
    assert enabled.drive.demand() == AT_REST


def test_enable_operation_calls_a_slow_down_off(enabled):
    enabled.control(SWITCH_ON, TORQUE)
    enabled.control(ENABLE, TORQUE)
    enabled.wait(5)
    assert enabled.drive.demand()[:2] == (TORQUE_NM, True)


def test_halt_slows_down_and_holds_in_operation_enabled(enabled):
    enabled.control(HALT, TORQUE)
    assert enabled.drive.demand()[:2] == (DAMPING_NM, True)
    enabled.move()
    assert enabled.drive.demand() == AT_REST
    assert enabled.state == "OPERATION_ENABLED"
    enabled.control(ENABLE, TORQUE)
    assert enabled.drive.demand()[:2] == (TORQUE_NM, True)


def test_a_short_circuit_leaves_no_power_to_slow_down_with(enabled):
    enabled.drive.inject(DriveFault.DRIVE, enabled.now_ns)
    assert enabled.state == "FAULT"
    assert enabled.drive.demand() == AT_REST
    assert [code(data) for data in enabled.take(EMCY)] == [0x2320]
    assert enabled.read(0x603F) == 0x2320
    assert enabled.read(0x1001) == 0b11  # generic and current


@pytest.mark.parametrize("option", range(5))
def test_fault_reaction_option_code(enabled, option):
    enabled.write(0x605E, 0, option)
    enabled.drive.inject(DriveFault.OVER_TEMPERATURE, enabled.now_ns)
    if option == 0:
        assert enabled.drive.demand() == AT_REST
        assert enabled.state == "FAULT"
    else:
        assert enabled.drive.demand()[:2] == (DAMPING_NM, True)
        assert enabled.state == "FAULT_REACTION_ACTIVE"
    assert enabled.read(0x1001) == 0b1001  # generic and temperature


def test_rpdo_timeout_faults_with_8250(enabled):
    enabled.write(0x1400, 5, 20)
    enabled.control(ENABLE, TORQUE)
    enabled.wait(20)
    assert enabled.state == "OPERATION_ENABLED"
    enabled.wait(1)
    assert enabled.state == "FAULT_REACTION_ACTIVE"
    assert [code(data) for data in enabled.take(EMCY)] == [0x8250]
    enabled.wait(300)
    assert enabled.drive.demand() == AT_REST
    assert "no RPDO" in enabled.drive.fault
    enabled.control(0)
    enabled.control(FAULT_RESET)
    assert enabled.state == "SWITCH_ON_DISABLED"
    assert code(enabled.take(EMCY)[0]) == 0  # error reset


@pytest.mark.parametrize(
    ("option", "state"),
    [
        (0, "OPERATION_ENABLED"), (1, "FAULT_REACTION_ACTIVE"), (2, "SWITCH_ON_DISABLED"),
        (3, "QUICK_STOP_ACTIVE"),
    ],
)  # fmt: skip
def test_abort_connection_option_code_at_a_lost_heartbeat(enabled, option, state):
    """CiA 402-2, object 0x6007."""
    enabled.write(0x6007, 0, option)
    enabled.write(0x1016, 1, MASTER << 16 | 50)
    enabled.hear(0x700 + MASTER, 5)
    enabled.wait(50)
    assert enabled.state == "OPERATION_ENABLED"
    enabled.wait(1)
    assert enabled.state == state
    assert [code(data) for data in enabled.take(EMCY)] == [0x8130]


@pytest.mark.parametrize(("behaviour", "state"), [(0, 127), (1, 5), (2, 4)])
def test_error_behaviour_decides_the_nmt_state_after_a_lost_heartbeat(enabled, behaviour, state):
    """CiA 301, object 0x1029: 0 pre-operational, 1 no change, 2 stopped."""
    enabled.write(0x1029, 1, behaviour)
    enabled.write(0x1016, 1, MASTER << 16 | 50)
    enabled.hear(0x700 + MASTER, 5)
    enabled.wait(51)
    enabled.take()
    enabled.wait(100)
    assert enabled.take(0x700 + NODE)[0] == bytes([state])


def test_a_lost_heartbeat_can_be_reset_once_it_is_back(enabled):
    enabled.write(0x1016, 1, MASTER << 16 | 50)
    enabled.hear(0x700 + MASTER, 5)
    enabled.wait(400)
    enabled.start()
    enabled.control(FAULT_RESET)
    assert enabled.state == "FAULT"
    enabled.hear(0x700 + MASTER, 5)
    enabled.control(0)
    enabled.control(FAULT_RESET)
    assert enabled.state == "SWITCH_ON_DISABLED"


def test_a_heartbeat_that_never_came_is_not_missed(enabled):
    enabled.write(0x1016, 1, MASTER << 16 | 50)
    enabled.wait(500)
    assert enabled.state == "OPERATION_ENABLED"


def test_bus_off_stops_the_joint_and_8140_reports_the_restart(enabled):
    enabled.drive.lose_bus(enabled.now_ns)
    assert enabled.state == "FAULT_REACTION_ACTIVE"
    enabled.wait(400)
    assert enabled.drive.demand() == AT_REST
    assert enabled.take() == []
    enabled.drive.regain_bus(enabled.now_ns)
    assert [code(data) for data in enabled.take(EMCY)] == [0x8140]
    enabled.start()
    enabled.control(FAULT_RESET)
    assert enabled.state == "SWITCH_ON_DISABLED"


@pytest.mark.parametrize("command", [2, 130])
def test_nmt_stop_and_reset_communication_stop_the_joint(enabled, command):
    enabled.hear(0, command, NODE)
    assert enabled.state == "FAULT_REACTION_ACTIVE"
    enabled.wait(301)
    assert enabled.drive.demand() == AT_REST


def test_reset_node_is_like_power_on_but_for_a_cause_that_is_still_there(enabled):
    enabled.write(0x605E, 0, 0)
    enabled.drive.inject(DriveFault.DRIVE, enabled.now_ns)
    enabled.take()
    enabled.hear(0, 129, NODE)
    enabled.wait(1)
    assert enabled.take(0x700 + NODE) == [b"\0"]  # boot-up
    assert enabled.state == "SWITCH_ON_DISABLED"
    assert enabled.read(0x605E) == 2
    assert enabled.read(0x1003, 0) == 0
    assert enabled.read(0x1001) == 0
    enabled.drive.inject(DriveFault.OVER_TEMPERATURE, enabled.now_ns)
    enabled.hear(0, 129, NODE)
    enabled.wait(1)
    assert enabled.state == "FAULT"
    assert enabled.read(0x603F) == 0x4310
    enabled.drive.clear(DriveFault.OVER_TEMPERATURE, enabled.now_ns)
    enabled.hear(0, 129, NODE)
    enabled.wait(1)
    assert enabled.state == "SWITCH_ON_DISABLED"


def test_errors_are_kept_newest_first_and_can_be_cleared(enabled):
    enabled.drive.inject(DriveFault.OVER_TEMPERATURE, enabled.now_ns)
    enabled.drive.inject(DriveFault.DRIVE, enabled.now_ns)
    assert enabled.read(0x1003, 0) == 2
    assert [enabled.read(0x1003, i) for i in (1, 2)] == [0x2320, 0x4310]
    enabled.write(0x1003, 0, 0)
    assert enabled.read(0x1003, 0) == 0
