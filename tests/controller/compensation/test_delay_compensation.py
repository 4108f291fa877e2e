"""The predictor against known motions, and commands in flight against what befalls them."""

import numpy as np
import pytest
from prediction_bench import FUNNEL, INERTIA, MS, SWING, Bench, compensation_of

from bus_schema.drive_feedback import critically_damped
from controller.compensation.command_timeline import (
    CAPACITY,
    LONGEST_HORIZON_NS,
    CommandFeedback,
    ahead,
    explains,
    no_commands,
    note,
    observe,
)
from controller.control_law import Tracking


@pytest.mark.parametrize("delay", [0, 1, 8, 48])
def test_a_perfect_model_foresees_the_true_motion(delay):
    bench = Bench()
    bench.run(160 + delay, delay)
    assert bench.predicted[159][0] == delay
    position, velocity = bench.prediction_error(range(delay + 2, 160))
    travelled = np.abs(bench.truth[159][0] - bench.truth[159 - max(delay, 1)][0]).max()
    assert position <= 2e-5
    assert velocity <= 2e-3
    assert delay < 8 or travelled > 100.0 * position  # so that doing nothing would not pass


def test_without_delay_the_law_sees_just_what_was_measured():
    bench = Bench(friction=True, missing=lambda velocity: -5.0 * np.tanh(velocity / 0.02))
    bench.run(50, 0)
    for tick in range(50):
        horizon_ms, position, velocity = bench.predicted[tick]
        assert horizon_ms == 0.0
        np.testing.assert_array_equal(position, bench.truth[tick][0])
        np.testing.assert_array_equal(velocity, bench.truth[tick][1])


def test_reference_and_funnel_are_those_of_the_instant_the_torque_acts():
    bench = Bench()
    bench.run(60, 20)
    expected, seen = Tracking(3), bench.compensation.predicted
    expected.position[:], expected.velocity[:] = seen.position, seen.velocity
    expected.update(0.059 + 0.020, 1e-3, SWING, FUNNEL)
    np.testing.assert_array_equal(seen.reference_position, expected.reference_position)
    np.testing.assert_array_equal(seen.bounds, expected.bounds)
    assert seen.step_s == 1e-3  # one step of memory for one state


@pytest.mark.parametrize("ticks", [18, 102])
def test_disturbance_is_learned_at_the_stated_bandwidth(ticks):
    push = np.array([6.0, -5.0, 3.0])
    bench = Bench(missing=lambda velocity: push)
    bench.run(ticks, 0)
    learned = bench.compensation.belief.disturbance_nm
    # 1 − e^(−60 t) of a constant push; the first step of motion ends at tick 1
    share = 1.0 - np.exp(-60.0 * 1e-3 * (ticks - 2))
    np.testing.assert_allclose(learned, push * share, rtol=0.03)


def test_varying_delay_is_followed():
    bench = Bench()
    bench.run(60, 10)
    assert bench.predicted[59][0] == 10.0
    bench.run(100, 25)
    assert bench.predicted[159][0] == pytest.approx(25.0, abs=0.01)
    bench.run(100, 5)
    assert bench.predicted[259][0] == pytest.approx(5.0, abs=0.01)


@pytest.mark.parametrize("delay", [0, 8, 48])
def test_what_the_drives_add_is_foreseen(delay):
    drive = critically_damped(INERTIA, 100.0)
    bench = Bench(drive=drive)
    bench.run(200 + delay, delay)
    position, velocity = bench.prediction_error(range(delay + 2, 200))
    travelled = np.abs(bench.truth[199][0] - bench.truth[199 - max(delay, 1)][0]).max()
    # Ten times what is allowed without drives: at 100 /s a loop changes its torque by a tenth in
    # each of the steps of 1 ms, within which the prediction takes it for constant.
    assert position <= 2e-4
    assert velocity <= 2e-2
    assert delay < 8 or travelled > 100.0 * position
    # Drives that are not predicted miss by far more: they hold what was pushed off its way.
    bench = Bench(compensation_of(), drive=drive, missing=lambda _: np.array([60.0, -50.0, 8.0]))
    bench.run(200 + delay, delay)
    unforeseen = bench.prediction_error(range(delay + 2, 200))[0]
    assert delay < 8 or unforeseen > 10.0 * position


def test_waiting_longer_than_expected_raises_the_horizon():
    bench = Bench(first_ns=20 * MS)
    bench.run(30, 30)
    horizons_ms = [bench.predicted[tick][0] for tick in (0, 20, 25, 29)]
    assert horizons_ms == pytest.approx([20.0, 20.0, 25.0, 29.0])


@pytest.mark.parametrize(("expected", "true"), [(50, 12), (5, 12)])
def test_the_first_command_in_force_replaces_what_was_expected(expected, true):
    bench = Bench(first_ns=expected * MS)
    bench.run(true + 3, true)
    assert bench.predicted[true - 1][0] == pytest.approx(max(expected, true - 1))
    assert bench.predicted[true][0] == pytest.approx(true)


def test_lost_command_leaves_its_predecessor_in_force():
    whole, holed = Bench(), Bench(lost=range(60, 66))
    for bench in (whole, holed):
        bench.run(150, 10)
    # The loss cannot be known before tick 70; the feedback that shows the gap sets it right.
    surprised = holed.prediction_error(range(60, 66))[1]
    assert surprised > 2.0 * whole.prediction_error(range(60, 66))[1]
    assert holed.prediction_error(range(76, 139))[0] < 1e-5


def test_lost_states_are_bridged():
    bench = Bench(missing=lambda velocity: np.array([6.0, -5.0, 3.0]))
    bench.run(100, 10)
    before = bench.compensation.belief.disturbance_nm.copy()
    bench.fly(30, 10)
    bench.run(60, 10)
    np.testing.assert_allclose(bench.compensation.belief.disturbance_nm, before, rtol=0.05)
    assert bench.prediction_error(range(131, 179))[0] < 5e-5


def test_plant_that_says_nothing_is_taken_to_act_after_the_least_horizon():
    bench = Bench(least_ns=20 * MS)
    bench.run(120, 20, gives_feedback=False)
    assert bench.predicted[99][0] == 20.0
    assert bench.prediction_error(range(25, 99))[0] < 3e-5


@pytest.mark.parametrize(
    "feedback",
    [
        CommandFeedback(2**63, 5 * MS), CommandFeedback(7, -1), CommandFeedback(7, 2**62),
        CommandFeedback(90, 0), CommandFeedback(-3, 0),
    ],
)  # fmt: skip
def test_an_echo_that_cannot_be_true_changes_nothing(feedback):
    bench, undisturbed = Bench(), Bench()
    for each in (bench, undisturbed):
        each.run(30, 5)
    horizon_ns = bench.compensation.horizon_ns
    seen = bench.compensation.predict(bench.measured, 30 * MS, feedback, SWING, FUNNEL)
    assert bench.compensation.horizon_ns == horizon_ns
    expected = undisturbed.compensation.predict(bench.measured, 30 * MS, None, SWING, FUNNEL)
    np.testing.assert_array_equal(seen.position, expected.position)


@pytest.mark.parametrize("size", [1e3, 1e100, 1e300])
def test_a_state_beyond_all_reason_is_answered_and_forgotten(size):
    bench = Bench()
    bench.run(30, 5)
    wild = Tracking(3)
    wild.position[:], wild.velocity[:] = size, -size
    seen = bench.compensation.predict(wild, 30 * MS, CommandFeedback(26, 5 * MS), SWING, FUNNEL)
    assert np.isfinite(seen.position).all()
    assert np.isfinite(seen.velocity).all()
    assert np.isfinite(bench.compensation.belief.disturbance_nm).all()


def test_no_prediction_reaches_further_than_half_a_second():
    bench = Bench()
    bench.run(30, 5)
    hour_ns = 3_600_000_000_000
    feedback = CommandFeedback(1, hour_ns)
    bench.compensation.predict(bench.measured, hour_ns, feedback, SWING, FUNNEL)
    bench.compensation.predict(
        bench.measured, 2 * hour_ns, CommandFeedback(2, hour_ns), SWING, FUNNEL
    )
    assert bench.compensation.horizon_ns == LONGEST_HORIZON_NS


def test_timeline_forgets_only_what_is_no_longer_in_flight():
    commands = no_commands(1)
    for number in range(1, CAPACITY + 100):
        note(commands, np.array([float(number)]), np.zeros((2, 1)), number, number * MS)
    now_ns = (CAPACITY + 100) * MS
    assert not explains(commands, 99, 0, now_ns)
    assert explains(commands, 100, 0, now_ns)
    observe(commands, CommandFeedback(CAPACITY, 50 * MS), now_ns, now_ns - MS)
    flight = ahead(commands, CAPACITY, now_ns)
    assert (flight.upcoming, flight.newest) == (CAPACITY + 50, CAPACITY + 99)
    assert (CAPACITY + 50) * MS + flight.delay_ns == now_ns


@pytest.mark.parametrize(("jitter_ms", "upcoming"), [(0, 102), (1, 101)])
def test_command_is_awaited_longer_where_delays_vary(jitter_ms, upcoming):
    """The next command is 1 ms overdue: lost if all took 5 ms, late if some took 6 ms."""
    commands = no_commands(1)
    for number in range(1, 110):
        note(commands, np.zeros(1), np.zeros((2, 1)), number, number * MS)
    for number in range(1, 101):
        delay_ms = 5 + jitter_ms * (-1) ** number
        now_ns = (number + delay_ms) * MS
        observe(commands, CommandFeedback(number, delay_ms * MS), now_ns, now_ns - MS)
    assert ahead(commands, 100, (101 + 5 + 1) * MS).upcoming == upcoming
