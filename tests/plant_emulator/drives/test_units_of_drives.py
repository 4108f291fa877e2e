"""Units and rounding: increments, increments per second, thousandths of the rated torque."""

import math

import pytest
from drive_bench import ENABLE, SETTINGS, Bench
from hypothesis import given
from hypothesis import strategies as st

from plant_emulator.drives.drive import DriveSettings

TURN = 1 << 20
COUNT_RAD = 2 * math.pi / TURN


@pytest.fixture(scope="module")
def bench():
    made = Bench()
    made.enable()
    return made


@given(st.floats(-100.0, 100.0))
def test_position_is_the_nearest_increment(bench, position_rad):
    bench.move(position_rad=position_rad)
    counts = bench.read(0x6064, signed=True)
    assert abs(counts * COUNT_RAD - position_rad) <= 0.5001 * COUNT_RAD


@pytest.mark.parametrize(
    ("turns", "counts"),
    [(2047.5, (1 << 31) - TURN // 2), (2048.0, -(1 << 31)), (-2049, (1 << 31) - TURN)],
)
def test_position_wraps_around_at_32_bits(bench, turns, counts):
    bench.move(position_rad=turns * 2 * math.pi)
    assert bench.read(0x6064, signed=True) == counts


@pytest.mark.parametrize(
    ("turns_s", "value"),
    [(1.0, TURN), (-0.25, -TURN // 4), (5000, (1 << 31) - 1), (-5000, -(1 << 31))],
)
def test_velocity_saturates(bench, turns_s, value):
    bench.move(velocity_rad_s=turns_s * 2 * math.pi)
    assert bench.read(0x606C, signed=True) == value


@pytest.mark.parametrize(
    ("torque_nm", "value"),
    [(20.0, 1000), (0.0099, 0), (0.0101, 1), (-0.0301, -2), (1e4, 32767), (-1e4, -32768)],
)
def test_actual_torque_is_the_nearest_thousandth_of_20_nm_and_saturates(bench, torque_nm, value):
    bench.move(torque_nm=torque_nm)
    assert bench.read(0x6077, signed=True) == value


@given(st.integers(-(1 << 15), (1 << 15) - 1))
def test_target_torque_is_exact_up_to_the_limit(bench, per_mille):
    bench.move()
    bench.control(ENABLE, per_mille)
    torque_nm, is_released, _ = bench.drive.demand()
    assert is_released
    assert torque_nm == pytest.approx(0.02 * max(-3000, min(3000, per_mille)), abs=1e-12)
    assert bool(bench.statusword & 1 << 11) == (abs(per_mille) > 3000)  # internal limit active
    assert bench.statusword & 1 << 12  # drive follows command value


def test_offset_and_max_torque():
    bench = Bench()
    bench.enable(100)
    bench.write(0x60B2, 0, -40)
    assert bench.drive.demand().torque_nm == pytest.approx(1.2)  # 60 ‰ of 20 N m
    bench.write(0x6072, 0, 50)
    assert bench.drive.demand().torque_nm == pytest.approx(1.0)
    bench.write(0x6072, 0, 60_000)  # more than the joint bears
    bench.control(ENABLE, 32_767)
    assert bench.drive.demand().torque_nm == pytest.approx(60.0)


def test_position_limits_let_no_torque_push_further():
    bench = Bench(
        settings=DriveSettings(**(vars(SETTINGS) | {"upper_rad": 1.0, "lower_rad": -2.0}))
    )
    bench.enable(100)
    assert bench.read(0x607D, 2, signed=True) == 166886
    for position_rad, per_mille, torque_nm in (
        (0.9, 100, 2.0), (1.1, 100, 0.0), (1.1, -100, -2.0), (-2.1, -100, 0.0), (-2.1, 100, 2.0),
    ):  # fmt: skip
        bench.move(position_rad=position_rad)
        bench.control(ENABLE, per_mille)
        assert bench.drive.demand().torque_nm == pytest.approx(torque_nm)
        assert bool(bench.statusword & 1 << 11) == (torque_nm == 0.0)
