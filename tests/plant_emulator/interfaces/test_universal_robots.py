"""``servoj`` and ``speedj``: lag, extrapolation, time-out, ``stopj`` and targets out of reach."""

import numpy as np
import pytest

from plant_emulator.interfaces.servoj import ServoJSettings
from plant_emulator.interfaces.speedj import SpeedJSettings
from tests.plant_emulator.interfaces.driven import driven, rows, started

H = 2e-3
SPEED = 0.4


def ramp(cycles):
    return [rows(SPEED * H * k) for k in range(cycles)]


def test_the_public_anchor_has_30_ms_in_the_robot():
    """0.03 s and 1200: 34 ms in all, of which 4 are the link's; half a cycle is the wait for it."""
    settings = ServoJSettings(lookahead_time_s=0.03, gain=1200)
    assert settings.lag_s(H, H) == pytest.approx(30e-3, abs=0.3e-3)
    cycles = 500
    position = driven(started(settings, H), ramp(cycles))[:, 0]
    behind_s = H * np.arange(cycles) - position / SPEED
    assert behind_s[300:].mean() == pytest.approx(30e-3, abs=0.3e-3)


@pytest.mark.parametrize(("lag_ms", "dead_ms"), [(40.0, 0.0), (0.0, 8.0), (25.0, 6.0)])
def test_a_set_response_lags_by_what_is_set(lag_ms, dead_ms):
    settings = ServoJSettings(lag_ms=lag_ms, dead_time_ms=dead_ms)
    cycles = 500
    position = driven(started(settings, H), ramp(cycles))[:, 0]
    behind_ms = 1e3 * (H * np.arange(cycles) - position / SPEED)[300:].mean()
    # Joints that follow at once are where the target is at the cycle; others smooth the steps.
    wait_ms = 0.5e3 * H if lag_ms else 0.0
    assert behind_ms == pytest.approx(lag_ms + dead_ms + wait_ms, rel=0.01)


def test_a_missing_target_is_extrapolated_with_the_last_speed():
    """With all targets, and with every second to ninth one missing, the motion is the same."""
    whole = driven(started(ServoJSettings(), H), ramp(200))
    thinned = [target if k % 9 in (0, 1) else None for k, target in enumerate(ramp(200))]
    np.testing.assert_allclose(driven(started(ServoJSettings(), H), thinned), whole, atol=1e-12)


def test_after_the_time_out_stopj_brakes_with_4_rad_s2():
    """0.4 rad/s for 20 ms more, then a braking distance of v²/2a, v²/8 = 20 mrad."""
    robot = started(ServoJSettings(lag_ms=0.0, dead_time_ms=0.0), H)
    found = driven(robot, [*ramp(101), *[None] * 200])
    begin = found[100, 0]
    silent = found[101:, 0] - begin
    np.testing.assert_allclose(silent[:9], SPEED * H * np.arange(1, 10), atol=1e-9)
    assert silent[-1] == pytest.approx(SPEED * 0.02 + SPEED**2 / 8.0, abs=2.0 * SPEED * H)
    assert found[-1, 1] == 0.0
    stops_after_s = H * (np.flatnonzero(found[101:, 1] > 0.0)[-1] + 1)
    assert stops_after_s == pytest.approx(0.02 + SPEED / 4.0, abs=3.0 * H)
    assert robot.reflex is None


def test_targets_that_need_more_than_20_rad_s_are_ignored():
    for step, is_taken in ((0.039, True), (0.041, False)):  # in 2 ms
        robot = started(ServoJSettings(lag_ms=0.0, dead_time_ms=0.0), H)
        found = driven(robot, [rows(0.0), rows(step)])
        assert found[1, 0] == (step if is_taken else 0.0)


def test_speedj_keeps_its_acceleration_limit_and_repeats_velocities():
    """1 rad/s at 40 rad/s² takes 25 ms; then the velocity stays until the time-out."""
    found = driven(started(SpeedJSettings(), H), [rows(0, 1.0), *[None] * 9, *[rows(0, 1.0)] * 30])
    np.testing.assert_allclose(found[:12, 1], 40.0 * H * np.arange(12), atol=1e-12)
    assert found[14:, 1] == pytest.approx(1.0)
    np.testing.assert_allclose(np.diff(found[14:, 0]), H, atol=1e-12)


def test_speedj_stops_after_its_time_out():
    found = driven(started(SpeedJSettings(), H), [*[rows(0, 0.8)] * 50, *[None] * 150])
    silent = found[50:, 1]
    assert silent[8] == pytest.approx(0.8)
    np.testing.assert_allclose(np.diff(silent[11:100]), -4.0 * H, atol=1e-12)
    assert silent[-1] == 0.0


def test_ideal_speedj_has_its_velocity_a_cycle_later():
    found = driven(started(SpeedJSettings(ideal=True), H), [rows(0, 5.0), rows(0, -5.0), rows(0)])
    assert found[:, 1].tolist() == [0.0, 5.0, -5.0]
    np.testing.assert_allclose(found[:, 0], [0.0, 2.5 * H, 2.5 * H], atol=1e-15)
