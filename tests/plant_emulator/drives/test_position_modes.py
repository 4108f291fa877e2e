"""Drives that close their loops: CiA 402's cyclic synchronous position, ODrive's position control.

The expected values follow the profile and ODrive's controller.
"""

import math

import pytest
from drive_bench import CSP, CST, SETTINGS, Bench
from test_cansimple import CLOSED_LOOP, LIMITS, SET_MODE, SET_STATE, Axis

COUNTS = SETTINGS.counts_per_turn / (2 * math.pi)
TARGET, WINDOW, WINDOW_MS, VELOCITY_OFFSET, TORQUE_OFFSET = 0x607A, 0x6065, 0x6066, 0x60B1, 0x60B2
FOLLOWING_ERROR, LIMITED = 1 << 13, 1 << 11
K_X, K_V = 30.0, 4.0
INPUT_POS, INPUT_VEL, POS_GAIN, VEL_GAINS, ABSOLUTE = 0x0C, 0x0D, 0x1A, 0x1B, 0x19
TURN = 2 * math.pi


def counts(radians):
    return round(radians * COUNTS)


@pytest.fixture
def bench():
    """A drive that follows in position mode, its joint at 0.5 rad."""
    made = Bench()
    made.move(position_rad=0.5)
    made.write(0x60FB, 1, round(K_X * 1000))
    made.write(0x60F9, 1, round(K_V * 1000))
    made.enable(mode=CSP)
    made.wait(1)
    return made


def given_nm(bench):
    demand = bench.drive.demand()
    assert demand.is_released
    return demand.torque_nm


def test_torque_is_that_of_position_and_velocity_loop_and_of_the_offsets(bench):
    bench.write(TARGET, 0, counts(0.6))
    bench.write(VELOCITY_OFFSET, 0, counts(0.3))
    bench.write(TORQUE_OFFSET, 0, 150)  # per mille of 20 N m
    bench.move(position_rad=0.5, velocity_rad_s=0.2)
    wanted = 3.0 + K_V * (0.3 + K_X * 0.1 - 0.2)
    assert given_nm(bench) == pytest.approx(wanted, abs=2e-3)
    closed = bench.drive.demand().loop  # at every step of the physics
    assert closed.torque_nm(0.55, 0.2) == pytest.approx(wanted - K_V * K_X * 0.05, abs=2e-3)


def test_a_drive_without_target_holds_its_joint(bench):
    assert given_nm(bench) == 0.0
    bench.move(position_rad=0.45)
    assert given_nm(bench) == pytest.approx(K_V * K_X * 0.05, abs=2e-3)
    assert bench.read(0x6062, signed=True) == counts(0.5)
    assert bench.read(0x60F4, signed=True) == counts(0.5) - counts(0.45)


def test_software_limits_hold_targets_back(bench):
    bench.write(0x607D, 2, counts(0.55))
    bench.write(TARGET, 0, counts(0.54))
    assert not bench.statusword & LIMITED
    bench.write(TARGET, 0, counts(3.0))
    assert bench.statusword & LIMITED
    assert given_nm(bench) == pytest.approx(K_V * K_X * 0.05, abs=2e-3)


def test_the_largest_torque_is_never_exceeded(bench):
    bench.write(TARGET, 0, counts(2.5))
    assert bench.drive.demand().torque_nm == 60.0
    bench.write(0x6072, 0, 500)
    assert bench.drive.demand().torque_nm == 10.0
    assert bench.statusword & LIMITED
    bench.write(TARGET, 0, counts(-2.5))
    assert bench.drive.demand().torque_nm == -10.0


@pytest.mark.parametrize("is_fault", [False, True])
def test_following_error_after_its_time_outside_the_window(bench, is_fault):
    bench.write(WINDOW, 0, counts(0.1))
    bench.write(WINDOW_MS, 0, 20)
    bench.write(0x2001, 0, int(is_fault))
    bench.write(TARGET, 0, counts(0.65))
    bench.wait(20)
    assert not bench.statusword & FOLLOWING_ERROR
    bench.wait(2)
    if is_fault:
        assert bench.state in ("FAULT", "FAULT_REACTION_ACTIVE")
        assert bench.read(0x603F) == 0x8611
        return
    assert bench.statusword & FOLLOWING_ERROR
    assert bench.state == "OPERATION_ENABLED"
    bench.move(position_rad=0.6)
    bench.wait(1)
    assert not bench.statusword & FOLLOWING_ERROR


def test_halt_and_quick_stop_slow_the_joint_down(bench):
    bench.write(TARGET, 0, counts(0.8))
    bench.move(position_rad=0.5, velocity_rad_s=1.0)
    for word in (0x10F, 0x00B):
        bench.control(word)
        assert bench.drive.demand().loop is None
        assert given_nm(bench) == pytest.approx(-SETTINGS.stop_damping_nm_s)


def test_integral_compensates_an_unknown_load(bench):
    bench.write(0x60F9, 2, 8000)
    joint, load_nm = 0.5, -3.0
    bench.write(TARGET, 0, counts(0.5))
    loop = bench.drive.demand().loop
    for _ in range(10_000):  # a joint without inertia goes to where its torques are in balance
        joint += 0.1 * (loop.torque_nm(joint, 0.0, 1e-3) + load_nm) / (K_V * K_X)
    assert joint == pytest.approx(0.5, abs=1e-4)
    bench.write(0x6040, 0, 6)
    bench.wait(1000)
    assert bench.drive.demand().loop is None
    for word in (7, 15):
        bench.write(0x6040, 0, word)
    assert given_nm(bench) == pytest.approx(0.0, abs=2e-3)  # what it had gathered is gone


def test_positions_beyond_32_bits_wrap_around(bench):
    """The target means those turns that are nearest to the joint's."""
    joint = 5000 * TURN
    bench.move(position_rad=joint)
    bench.write(TARGET, 0, bench.read(0x6064, signed=True) + counts(0.1))
    assert given_nm(bench) == pytest.approx(K_V * K_X * 0.1, abs=5e-3)


def test_modes_change_while_it_follows(bench):
    bench.write(TARGET, 0, counts(0.6))
    bench.write(0x6071, 0, 100)
    bench.write(0x6060, 0, CST)
    assert bench.drive.demand().loop is None
    assert given_nm(bench) == pytest.approx(2.0)
    bench.write(0x6060, 0, CSP)
    assert given_nm(bench) == pytest.approx(K_V * K_X * 0.1, abs=2e-3)


# ODrive


@pytest.fixture
def axis():
    """An axis in closed-loop position control, its joint at a quarter turn."""
    made = Axis()
    made.move(position_rad=TURN / 4)
    made.send(POS_GAIN, "f", K_X)
    made.send(VEL_GAINS, "ff", K_V, 0.0)
    made.send(SET_MODE, "II", 3, 1)
    made.send(SET_STATE, "I", CLOSED_LOOP)
    return made


def test_an_axis_controls_position_with_both_feed_forwards(axis):
    """Gains in (rev/s)/rev and N m/(rev/s), feed-forwards in thousandths."""
    axis.send(INPUT_POS, "fhh", 0.3, 200, -1500)
    axis.move(position_rad=TURN / 4, velocity_rad_s=0.1 * TURN)
    wanted = -1.5 + K_V * (0.2 + K_X * 0.05 - 0.1)
    assert axis.drive.demand().torque_nm == pytest.approx(wanted, abs=1e-4)
    assert axis.drive.demand().loop.torque_nm(0.3 * TURN, 0.2 * TURN) == pytest.approx(
        -1.5, abs=1e-4
    )
    assert axis.drive.targets == 1


def test_an_axis_holds_its_joint_until_it_has_an_input(axis):
    assert axis.drive.demand()[:2] == (0.0, True)
    axis.move(position_rad=0.2 * TURN)
    assert axis.drive.demand().torque_nm == pytest.approx(K_V * K_X * 0.05, abs=1e-4)


def test_an_axis_controls_velocity(axis):
    axis.send(SET_MODE, "II", 2, 1)
    axis.send(INPUT_VEL, "ff", 0.5, 2.0)
    axis.move(position_rad=3.0, velocity_rad_s=0.3 * TURN)
    assert axis.drive.demand().torque_nm == pytest.approx(2.0 + K_V * 0.2, abs=1e-4)


def test_limits_of_an_axis_hold_for_speed_wanted_and_torque(axis):
    axis.send(LIMITS, "ff", 0.5, 60.0)
    axis.send(INPUT_POS, "fhh", 3.0, 0, 0)
    assert axis.drive.demand().torque_nm == pytest.approx(K_V * 0.5, abs=1e-4)
    axis.send(LIMITS, "ff", 0.5, 1.25)
    assert axis.drive.demand().torque_nm == 1.25


def test_an_absolute_position_is_that_of_estimates_and_inputs(axis):
    axis.send(ABSOLUTE, "f", 2.0)
    assert axis.ask(0x09, "ff")[0] == pytest.approx(2.0)
    assert axis.drive.demand().torque_nm == pytest.approx(0.0, abs=1e-3)  # it stays where it is
    axis.send(INPUT_POS, "fhh", 2.1, 0, 0)
    assert axis.drive.demand().loop.target_rad == pytest.approx(0.35 * TURN)
