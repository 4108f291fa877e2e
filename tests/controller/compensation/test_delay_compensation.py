"""The predictor against known motions, and commands in flight against what befalls them."""

from pathlib import Path

import numpy as np
import pytest

from bus_schema.robot_description import load_robot
from controller.compensation.command_timeline import (
    CAPACITY,
    LONGEST_HORIZON_NS,
    CommandFeedback,
    CommandTimeline,
)
from controller.compensation.delay_compensation import DelayCompensation
from controller.compensation.motion_predictor import SMOOTHING_RAD_S
from controller.control_law import Tracking
from controller.funnel import Funnel
from controller.manipulator_model import ManipulatorModel
from controller.reference import JointSinusoids
from deploy.scenario.referenced_files import find_urdf

MS = 1_000_000
ROBOT = load_robot(find_urdf("paper_arm", Path()))
MODEL = ManipulatorModel(ROBOT)
SWING = JointSinusoids(np.array([0.1, -0.5, 0.8]), np.array([[[0.1, 2.0, 0.3]] * 3]))
FUNNEL = Funnel(np.full(3, 0.3), np.full(3, 0.3), np.full(3, 0.01), 4.0)
START = np.array([0.2, -0.7, 1.1])
SETTINGS = {"observer_bandwidth_rad_s": 60.0, "learn_friction": False, "least_horizon_ns": 0}


class Bench:
    """A compensation at an arm whose true motion is integrated in steps of 0.1 ms.

    The torque that answers the state of a tick acts `delay` ticks later and swings about gravity; a
    command whose tick is in `lost` never arrives.
    """

    def __init__(self, *, missing=None, lost=(), **settings):
        self.compensation = DelayCompensation(MODEL, **(SETTINGS | settings))
        self.missing = missing or (lambda velocity: np.zeros(3))
        self.lost = lost
        self.measured = Tracking(3)
        self.measured.position[:] = START
        self.predicted, self.truth, self.in_force = {}, {}, (0, -1, None)
        self.sent, self.tick = {}, 0

    def run(self, ticks, delay, *, gives_feedback=True):
        """Ticks with a state each, which comes with or without feedback."""
        for _ in range(ticks):
            tick, state = self.tick, self.measured
            state.update(tick * 1e-3, 1e-3 if tick else 0.0, SWING, FUNNEL)
            feedback = CommandFeedback(*self.in_force[:2]) if gives_feedback else None
            seen = self.compensation.predict(state, tick * MS, feedback, SWING, FUNNEL)
            horizon_ms = self.compensation.timeline.horizon_ns / MS
            self.predicted[tick] = horizon_ms, seen.position.copy(), seen.velocity.copy()
            swing = np.array([40.0, 60.0, 15.0]) * np.sin(0.02 * tick + np.arange(3))
            self.sent[tick] = MODEL.gravity(state.position) + swing
            self.compensation.note_command(len(self.sent), tick * MS, self.sent[tick])
            self.fly(1, delay)

    def fly(self, ticks, delay):
        """Ticks whose states are lost."""
        for _ in range(ticks):
            self.truth[self.tick] = self.measured.position.copy(), self.measured.velocity.copy()
            self._let_act(self.tick - delay, self.tick)
            self._move()
            self.tick += 1
            self._let_act(self.tick - delay, self.tick)

    def _let_act(self, answered, now):
        numbers = {tick: number for number, tick in enumerate(self.sent, start=1)}
        number = 0 if answered in self.lost else numbers.get(answered, 0)
        if number > self.in_force[0]:
            self.in_force = number, (now - answered) * MS, self.sent[answered]

    def _move(self):
        if self.in_force[2] is None:
            return
        step_s, state = 1e-4, self.measured
        for _ in range(10):
            torque = self.in_force[2] + self.missing(state.velocity)
            change = step_s * MODEL.forward_dynamics(state.position, state.velocity, torque)
            state.position += step_s * (state.velocity + 0.5 * change)
            state.velocity += change

    def prediction_error(self, ticks):
        """Largest error of predictions made at these ticks: of positions, of velocities."""
        errors = []
        for tick in ticks:
            horizon_ms, position, velocity = self.predicted[tick]
            truth = self.truth[tick + round(horizon_ms)]
            errors.append((np.abs(position - truth[0]).max(), np.abs(velocity - truth[1]).max()))
        return np.max(errors, axis=0)


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
    bench = Bench(learn_friction=True, missing=lambda velocity: -5.0 * np.tanh(velocity / 0.02))
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


def test_a_held_arm_is_foreseen_at_rest_until_its_first_command_acts():
    bench = Bench()
    bench.run(100, 30)
    for tick in range(31):
        # the state of tick k is answered at k + 30, of which k ticks were in motion
        _, position, _ = bench.predicted[tick]
        at_rest, moving = START, bench.truth[tick + 30][0]
        np.testing.assert_allclose(position, moving, atol=2e-5)
        if tick < 2:
            np.testing.assert_allclose(position, at_rest, atol=1e-4)
    assert np.abs(bench.truth[60][0] - START).max() > 1e-3


def test_horizon_is_known_to_be_no_shorter_than_what_was_waited_for_the_first_command():
    bench = Bench()
    bench.run(40, 30)
    assert [bench.predicted[tick][0] for tick in range(0, 40, 10)] == [0.0, 10.0, 20.0, 30.0]


def test_disturbance_is_learned_at_the_stated_bandwidth():
    push = np.array([6.0, -5.0, 3.0])
    bench = Bench(missing=lambda velocity: push)
    bench.run(2, 0)
    bench.run(100, 0)
    learned = bench.compensation.missing.disturbance_nm
    # 1 − e^(−60 t) of a constant push; the first step of motion ends at tick 1
    np.testing.assert_allclose(learned, push * (1.0 - np.exp(-60.0 * 0.100)), rtol=0.02)
    bench = Bench(missing=lambda velocity: push)
    bench.run(18, 0)
    learned = bench.compensation.missing.disturbance_nm
    np.testing.assert_allclose(learned, push * (1.0 - np.exp(-60.0 * 0.016)), rtol=0.03)


def test_coulomb_friction_is_told_apart_from_a_disturbance():
    push, coulomb = np.array([6.0, -5.0, 3.0]), np.array([8.0, 6.0, 4.0])

    def missing(velocity):
        return push - coulomb * np.tanh(velocity / SMOOTHING_RAD_S)

    errors = {}
    for learn_friction in (False, True):
        bench = Bench(missing=missing, learn_friction=learn_friction)
        bench.run(900, 40)
        errors[learn_friction] = bench.prediction_error(range(500, 850))
        learned = bench.compensation.missing
        if learn_friction:
            np.testing.assert_allclose(learned.coulomb_nm, coulomb, rtol=0.25)
        else:
            assert learned.coulomb_nm.tolist() == [0.0, 0.0, 0.0]
    # the swing reverses about every 160 ms, and half of all predictions span a flip
    assert (errors[True] < 0.5 * errors[False]).all(), errors


def test_varying_delay_is_followed():
    bench = Bench()
    bench.run(60, 10)
    assert bench.predicted[59][0] == 10.0
    bench.run(100, 25)
    assert bench.predicted[159][0] == pytest.approx(25.0, abs=0.01)
    bench.run(100, 5)
    assert bench.predicted[259][0] == pytest.approx(5.0, abs=0.01)


def test_lost_command_leaves_its_predecessor_in_force():
    whole, holed = Bench(), Bench(lost=range(60, 66))
    for bench in (whole, holed):
        bench.run(150, 10)
    # What is lost nobody can know before tick 70; the feedback that shows the gap sets it right.
    surprised = holed.prediction_error(range(60, 66))[1]
    assert surprised > 2.0 * whole.prediction_error(range(60, 66))[1]
    assert holed.prediction_error(range(76, 139))[0] < 1e-5


def test_lost_states_are_bridged():
    bench = Bench(missing=lambda velocity: np.array([6.0, -5.0, 3.0]))
    bench.run(100, 10)
    before = bench.compensation.missing.disturbance_nm.copy()
    bench.fly(30, 10)
    bench.run(60, 10)
    np.testing.assert_allclose(bench.compensation.missing.disturbance_nm, before, rtol=0.05)
    assert bench.prediction_error(range(131, 179))[0] < 5e-5


def test_plant_that_says_nothing_is_taken_to_act_after_the_least_horizon():
    bench = Bench(least_horizon_ns=20 * MS)
    bench.run(120, 20, gives_feedback=False)
    assert bench.predicted[99][0] == 20.0
    assert bench.prediction_error(range(25, 99))[0] < 3e-5


def test_play_out_is_the_least_horizon():
    bench = Bench(least_horizon_ns=20 * MS)
    bench.run(60, 12)
    assert {horizon_ms for horizon_ms, *_ in bench.predicted.values()} == {20.0}


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
    horizon_ns = bench.compensation.timeline.horizon_ns
    seen = bench.compensation.predict(bench.measured, 30 * MS, feedback, SWING, FUNNEL)
    assert bench.compensation.timeline.horizon_ns == horizon_ns
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
    assert np.isfinite(bench.compensation.missing.disturbance_nm).all()


def test_no_prediction_reaches_further_than_half_a_second():
    bench = Bench()
    bench.run(30, 5)
    hour_ns = 3_600_000_000_000
    feedback = CommandFeedback(1, hour_ns)
    bench.compensation.predict(bench.measured, hour_ns, feedback, SWING, FUNNEL)
    bench.compensation.predict(
        bench.measured, 2 * hour_ns, CommandFeedback(2, hour_ns), SWING, FUNNEL
    )
    assert bench.compensation.timeline.horizon_ns == LONGEST_HORIZON_NS


def test_reset_repeats_itself_bit_for_bit():
    def motion():
        bench.run(80, 10)
        return [position.tobytes() for _, position, _ in bench.predicted.values()]

    bench = Bench(learn_friction=True)
    first, compensation = motion(), bench.compensation
    compensation.reset()
    bench = Bench()
    bench.compensation = compensation
    assert motion() == first


def test_timeline_forgets_only_what_is_no_longer_in_flight():
    timeline = CommandTimeline(1, 0)
    for number in range(1, CAPACITY + 100):
        timeline.note(number, number * MS, np.array([float(number)]))
    now_ns = (CAPACITY + 100) * MS
    assert not timeline.explains(CommandFeedback(99, 0), now_ns)
    assert timeline.explains(CommandFeedback(100, 0), now_ns)
    timeline.observe(CommandFeedback(CAPACITY, 50 * MS), now_ns)
    ahead = timeline.ahead(CAPACITY, now_ns)
    assert (ahead.upcoming, ahead.newest) == (CAPACITY + 50, CAPACITY + 99)
    assert ahead.acts_ns(ahead.upcoming) == now_ns
