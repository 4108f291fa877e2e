"""Rows of a command after its first: the torques that the believed arm needs from then on."""

import numpy as np
import pytest
from prediction_bench import FUNNEL, LIMITS, MODEL, MS, SWING, compensation_of

from controller.compensation.command_timeline import PIECES, HorizonSettings, command_at
from plant_emulator.command_gate import Rows

TICKS = 10
"""From one row to the next; the bridge is 40 ms long."""
BRIDGED = HorizonSettings(first_ns=20 * MS, is_announced=True, row_ticks=TICKS, tick_ns=MS)


def filled(error=0.0, error_rate=0.0, first_nm=(1.0, 2.0, 3.0), limits=LIMITS, believe=None):
    """Rows of a command that acts at 0.5 s with these errors, and its targets."""
    compensation = compensation_of(horizon=BRIDGED, limits=limits)
    if believe is not None:
        believe(compensation.belief)
    torques_nm, targets = np.zeros((1 + PIECES, 3)), np.zeros((2, 1 + PIECES, 3))
    torques_nm[0] = first_nm
    predicted = compensation.predicted
    predicted.horizon_s = 0.02
    predicted.update(0.5, 0.001, SWING, FUNNEL)
    predicted.position[:] = predicted.reference_position + error
    predicted.velocity[:] = predicted.reference_velocity + error_rate
    predicted.update(0.5, 0.001, SWING, FUNNEL)
    compensation.bridge(torques_nm, targets, SWING)()
    return torques_nm, targets, compensation


def reference_at(time_s):
    motion = np.zeros((3, 3))
    SWING.evaluate(time_s, *motion)
    return motion


def test_torques_change_as_those_of_the_model_along_the_reference():
    torques_nm, targets, _ = filled()
    at_first = MODEL.inverse_dynamics(*reference_at(0.5))
    for row in range(1 + PIECES):
        motion = reference_at(0.5 + 1e-3 * TICKS * row)
        change = MODEL.inverse_dynamics(*motion) - at_first
        np.testing.assert_allclose(torques_nm[row], torques_nm[0] + change, atol=1e-9)
        moved = motion[0] - reference_at(0.5)[0] - 0.02 * (targets[1, row] - targets[1, 0])
        np.testing.assert_allclose(targets[0, row] - targets[0, 0], moved, atol=1e-12)


def test_friction_of_the_belief_is_part_of_the_change():
    def believe(belief):
        belief.viscous_nm_s[:] = 10.0

    change = filled(believe=believe)[0] - filled()[0]
    faster = reference_at(0.5 + 1e-3 * TICKS * PIECES)[1] - reference_at(0.5)[1]
    np.testing.assert_allclose(change[-1], 10.0 * faster, atol=1e-9)


def test_an_error_is_planned_to_vanish_critically_damped():
    """e(t) = (e + ω e t) exp(−ω t): with ω = 15 rad/s, 87.8 % of 1 mrad are left after 40 ms."""
    _, targets, _ = filled(error=1e-3)
    _, on_reference, _ = filled()
    away = targets - on_reference
    position = away[0] + 0.02 * away[1]
    np.testing.assert_allclose(position[-1] - position[0], -1e-3 * (1 - 0.8781), atol=1e-7)


def test_rows_stay_within_the_torque_limits_and_repeat_the_first_where_numbers_overflow():
    torques_nm, _, _ = filled(first_nm=LIMITS, limits=LIMITS)
    assert (np.abs(torques_nm) <= LIMITS).all()
    overflown, targets, _ = filled(error=1e200, error_rate=1e200)
    np.testing.assert_array_equal(overflown, np.tile([1.0, 2.0, 3.0], (1 + PIECES, 1)))
    assert (targets == 0.0).all()


@pytest.mark.parametrize(
    ("at_ms", "tick"),
    [(29.9, 0), (30.0, 0), (30.9, 0), (31.0, 1), (45.5, 15), (70.0, 40), (99, 40)],
)
def test_predictor_reads_what_acts_at_a_tick(at_ms, tick):
    """A command answers the state of 10 ms, acts after 20 ms, and has a row each 10 ms until 70."""
    torques_nm, targets, compensation = filled()
    plant = Rows(torques_nm, np.moveaxis(targets, 0, 1), TICKS)
    compensation.note_command(1, 10 * MS, torques_nm[0])
    values = np.zeros((3, 3))
    age_s = command_at(compensation.commands, 1, round(at_ms * MS), values)
    torque_nm, target = plant.at(tick)
    np.testing.assert_allclose(values[0], torque_nm, atol=1e-12)
    np.testing.assert_allclose(values[1:], target, atol=1e-12)
    assert age_s == pytest.approx(1e-3 * (at_ms - 10 - tick))
