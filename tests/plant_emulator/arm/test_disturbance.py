import math

import numpy as np
import pytest

from plant_emulator.arm.disturbance import add_disturbance, disturbance_table
from plant_emulator.configuration import DisturbanceConfiguration

NAMES = ("yaw", "shoulder", "elbow")


def table_of(*terms, enabled=True, seed=0):
    configuration = DisturbanceConfiguration(enabled=enabled, terms=list(terms))
    return disturbance_table(configuration, NAMES, np.random.default_rng(seed))


def torque(table, time_s):
    out = np.full(3, np.nan)
    add_disturbance(time_s, table, out)
    return out


def series(table, times_s, joint=0):
    return np.array([torque(table, float(time_s))[joint] for time_s in times_s])


def test_scale_is_a_factor_on_the_torques_of_all_terms():
    terms = [
        {"joint": "yaw", "kind": "constant", "torque_nm": 2.0},
        {"joint": "elbow", "kind": "step", "torque_nm": -3.0, "start_s": 1.0},
    ]
    configuration = DisturbanceConfiguration(terms=terms, scale=0.5)
    table = disturbance_table(configuration, NAMES, np.random.default_rng(0))
    assert torque(table, 0.9).tolist() == [1.0, 0.0, 0.0]
    assert torque(table, 1.0).tolist() == [1.0, 0.0, -1.5]


def test_sine_follows_its_formula():
    sine = {"amplitude_nm": 3.0, "frequency_rad_s": 2.0, "phase_rad": 0.4}
    table = table_of({"joint": "elbow", "kind": "sine"} | sine)
    for time_s in np.linspace(0.0, 20.0, 50):
        expected = 3.0 * math.sin(2.0 * time_s + 0.4)
        assert torque(table, time_s)[2] == pytest.approx(expected, abs=1e-12)


def test_pulse_acts_from_its_start_up_to_its_end():
    table = table_of(
        {"joint": "yaw", "kind": "pulse", "torque_nm": 4.0, "start_s": 1.5, "duration_s": 0.5}
    )
    assert series(table, [1.499999, 1.5, 1.999999, 2.0]).tolist() == [0.0, 4.0, 4.0, 0.0]


def test_terms_add_up_and_all_means_all():
    table = table_of(
        {"joint": "all", "kind": "constant", "torque_nm": 1.0},
        {"joint": "shoulder", "kind": "constant", "torque_nm": 2.0},
        {"joint": "shoulder", "kind": "step", "torque_nm": 4.0, "start_s": 1.0},
    )
    assert torque(table, 0.5).tolist() == [1.0, 3.0, 1.0]
    assert torque(table, 1.0).tolist() == [1.0, 7.0, 1.0]


def test_disabled_disturbance_is_none_at_all():
    table = table_of({"joint": "all", "kind": "constant", "torque_nm": 1.0}, enabled=False)
    assert torque(table, 1.0).tolist() == [0.0, 0.0, 0.0]


NOISE = {"joint": "all", "kind": "noise", "rms_nm": 2.0, "lowest_hz": 5.0, "highest_hz": 45.0}


def test_noise_has_its_strength():
    values = series(table_of(NOISE), np.arange(20_000) * 2e-3)
    # 48 sinusoids of equal power: over 40 s their cross terms average out to about 1 %.
    assert np.sqrt(np.mean(values**2)) == pytest.approx(2.0, rel=0.04)
    assert abs(np.mean(values)) < 0.05


def test_noise_stays_within_its_band_and_fills_it():
    values = series(table_of(NOISE), np.arange(20_000) * 2e-3)
    power = np.abs(np.fft.rfft(values * np.hanning(values.size))) ** 2
    frequency = np.fft.rfftfreq(values.size, 2e-3)
    inside = (frequency > 4.9) & (frequency < 45.1)
    # What leaks out of a Hann window over 40 s falls off with the sixth power of the distance.
    assert power[~inside].sum() < 1e-6 * power.sum()
    for low in range(5, 45, 10):  # 12 of 48 sinusoids, one per 0.83 Hz, in each quarter
        part = power[(frequency >= low) & (frequency < low + 10)].sum() / power.sum()
        assert part == pytest.approx(0.25, abs=0.05)


def test_noise_is_a_function_of_seed_and_time_alone():
    times = np.linspace(0.0, 3.0, 200)
    first = series(table_of(NOISE, seed=1), times)
    assert series(table_of(NOISE, seed=1), times[::-1])[::-1].tolist() == first.tolist()
    assert np.abs(series(table_of(NOISE, seed=2), times) - first).max() > 1.0
