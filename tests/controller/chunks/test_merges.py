"""Rules by which a new chunk takes over from the one in force."""

from __future__ import annotations

import math

import numpy as np
import pytest

from bus_schema.configuration import ConfigurationError
from controller.chunks.answer import Answer, Holding
from controller.chunks.configuration import ChunksConfiguration
from controller.control_law import Diagnostics, Tracking
from controller.slow_law import AnswerTiming, ChunkRules, SlowLaw

TICK_S, ACTION_S, HORIZON = 0.001, 0.040, 16
SPEED = 0.5


def merge_of(inference_s=0.1, joints=1, **chunks):
    given = ChunksConfiguration.model_validate(
        {"horizon": HORIZON, "period_ms": 1e3 * ACTION_S, **chunks}
    )
    return given, given.build(TICK_S, inference_s, np.full(joints, np.inf))


def answer(at_s, positions, velocity=0.0):
    rows = len(positions)
    targets = np.stack([np.array(positions, float), np.full(rows, velocity)], axis=1)[:, :, None]
    return Answer(at_s, at_s, ACTION_S, np.zeros((1, 1)), targets, Holding())


def positions(chunk):
    return chunk.targets[:, 0, 0]


OLD, NEW = answer(0.0, np.arange(16.0)), answer(0.2, 100.0 + np.arange(16.0))
"""The new one begins five actions later: action i of it is action i + 5 of the old one."""


def test_replace_acts_at_once():
    _, merge = merge_of(merge="replace")
    assert merge.merged(OLD, NEW, 0.3) is NEW


def test_weighted_is_a_mean_where_both_have_rows():
    """LeRobot's: 0.3 old + 0.7 new; 11 actions overlap, and those before now have no effect."""
    _, merge = merge_of(merge="weighted")
    found = positions(merge.merged(OLD, NEW, 0.2))
    np.testing.assert_allclose(found[:11], 0.3 * np.arange(5, 16) + 0.7 * (100 + np.arange(11)))
    np.testing.assert_array_equal(found[11:], 100 + np.arange(11, 16))


def test_ensemble_weights_older_chunks_more():
    """ACT: exp(−m i), i = 0 for the oldest, normalised."""
    _, merge = merge_of(merge="temporal_ensemble", temporal_ensemble={"rate": 0.5})
    merge.merged(OLD, NEW, 0.2)
    third = answer(0.4, 200.0 + np.arange(16.0))
    found = positions(merge.merged(OLD, third, 0.4))
    weights = [1.0, math.exp(-0.5), math.exp(-1.0)]
    for row in range(6):
        told = [10.0 + row, 105.0 + row, 200.0 + row]
        assert found[row] == pytest.approx(np.average(told, weights=weights))
    assert found[6] == pytest.approx(np.average([111.0, 206.0], weights=weights[:2]))
    np.testing.assert_array_equal(found[11:], 200 + np.arange(11, 16))


@pytest.mark.parametrize("merge", ["temporal_ensemble", "weighted", "frozen_prefix"])
def test_equal_chunks_stay_to_the_bit(merge):
    more = {"ask_every": 8} if merge == "frozen_prefix" else {}
    _, rule = merge_of(merge=merge, **more)
    value, in_force = 0.1 + 0.2, answer(0.0, [0.1 + 0.2] * 16)
    for number in range(1, 40):
        now_s = number * 3 * ACTION_S
        in_force = rule.merged(in_force, answer(now_s, [value] * 16), now_s)
        assert (positions(in_force) == value).all()


def test_prefix_is_frozen_and_old_actions_fade_out():
    """Real-time chunking: d = 3 of 100 ms, s = 8, H = 16: five weights between 1 and 0."""
    _, merge = merge_of(merge="frozen_prefix", ask_every=8)
    at = answer(8 * ACTION_S, 100.0 + np.arange(16.0))
    found = positions(merge.merged(OLD, at, 8 * ACTION_S))
    old, new = np.arange(8, 16), 100.0 + np.arange(16)
    np.testing.assert_array_equal(found[:3], old[:3])
    weights = np.array([5, 4, 3, 2, 1]) / 6
    np.testing.assert_allclose(found[3:8], weights * old[3:] + (1 - weights) * new[3:8])
    np.testing.assert_array_equal(found[8:], new[8:])


def test_exponential_weights_are_those_of_the_paper():
    _, merge = merge_of(
        merge="frozen_prefix", ask_every=8, frozen_prefix={"weights": "exponential"}
    )
    _, weights, delay_steps = merge.guidance(OLD, 0.3)
    linear = np.array([5, 4, 3, 2, 1]) / 6
    np.testing.assert_allclose(weights[3:8], linear * np.expm1(linear) / np.expm1(1.0))
    assert delay_steps == 3


def test_prefix_refuses_a_delay_longer_than_what_is_left():
    with pytest.raises(ConfigurationError, match=r"d is 9, s is 8 and H is 16"):
        merge_of(merge="frozen_prefix", ask_every=8, inference_s=0.35)
    with pytest.raises(ConfigurationError, match="H is not set"):
        merge_of(merge="frozen_prefix", ask_every=8, horizon=None)


@pytest.mark.parametrize("merge", ["temporal_ensemble", "frozen_prefix", "spline", "synchronous"])
def test_count_alignment_is_refused_where_rows_must_be_meant_for_a_time(merge):
    with pytest.raises(ConfigurationError, match="must be time with"):
        merge_of(merge=merge, align="count")


def test_curve_keeps_its_limits_and_ends_on_the_chunk():
    pytest.importorskip("ruckig")
    limits = {"acceleration_rad_s2": 10.0, "jerk_rad_s3": 200.0}
    _, merge = merge_of(merge="spline", spline=limits)
    old, new = answer(0.0, 0.5 * ACTION_S * np.arange(16)), answer(0.2, [0.3] * 16)
    found = merge.merged(old, new, 0.3)
    place, speed = found.targets[found.row_at(0.3) :, :, 0].T
    assert place[0] == old.target_at(0.3)[0, 0]
    assert place[-1] == 0.3
    acceleration = np.diff(speed) / TICK_S
    assert np.abs(acceleration).max() <= 10.0 + 1e-6
    assert np.abs(np.diff(acceleration)).max() / TICK_S <= 200.0 + 1e-3


def moving(at_s, jerk, offset, rows=400):
    """A chunk with a row for each tick of a motion with constant jerk, from a common origin."""
    times_s = at_s + TICK_S * np.arange(rows)
    motion = [offset + jerk * times_s**3 / 6.0, jerk * times_s**2 / 2.0]
    return Answer(
        at_s, at_s, TICK_S, np.zeros((1, 1)), np.stack(motion, axis=1)[:, :, None], Holding()
    )


def test_whole_motion_keeps_the_jerk_limit_across_switches():
    """A third difference is a mean of the jerk, so none passes the limit where the curve joins.

    The motion has 5 rad/s³; it accelerates by 1 to 3 rad/s² at its switches, the second of which
    falls within the curve of the first.
    """
    pytest.importorskip("ruckig")
    limits = {"acceleration_rad_s2": 20.0, "jerk_rad_s3": 500.0}
    _, merge = merge_of(merge="spline", spline=limits, period_ms=1.0, horizon=400)
    in_force, found = moving(0.0, 5.0, 0.0), []
    switches = {
        0.2: moving(0.18, 5.0, 0.02),
        0.26: moving(0.25, 5.0, -0.03),
        0.6: moving(0.5, 5.0, 0),
    }
    for tick in range(850):
        now_s = tick * TICK_S
        if (new := switches.get(round(now_s, 6))) is not None:
            before = in_force.target_at(now_s)
            in_force = merge.merged(in_force, new, now_s)
            np.testing.assert_array_equal(in_force.target_at(now_s), before)
        found.append(in_force.target_at(now_s)[0, 0])
    jerk = np.diff(found, 3) / TICK_S**3
    assert 400.0 < np.abs(jerk).max() <= 505.0  # slopes of rows are off by half a tick's jerk
    assert found[-1] == switches[0.6].target_at(0.849)[0, 0]


def test_curve_does_not_change_when_the_law_is_asked():
    """Half of 16 actions are left after eight, whichever rule joins the chunks."""
    pytest.importorskip("ruckig")
    _, law, _ = run(merge="spline")
    _, other, _ = run(merge="replace")
    assert law.asked_s == other.asked_s


class Perfect:
    """A policy whose actions are exactly on a line of constant speed."""

    def __init__(self):
        self.diagnostics, self.asked_s, self.told = Diagnostics(1), [], []

    def reset(self):
        self.asked_s.clear()

    def torque(self, tracking):
        return np.zeros(1)

    def guide(self, prefix, weights, delay_steps):
        self.told.append((prefix, weights, delay_steps))

    def target(self, tracking):
        self.asked_s.append(tracking.time_s)
        at_s = tracking.time_s + ACTION_S * np.arange(HORIZON)
        return np.stack([SPEED * at_s, np.full(HORIZON, SPEED)], axis=1)[:, :, None]


def run(seconds=4.0, inference_s=0.1, law=None, **chunks):
    """Positions at each tick, the law, and its slow form."""
    law = Perfect() if law is None else law
    given, merge = merge_of(inference_s=inference_s, **chunks)
    rules = ChunkRules(merge, ACTION_S, HORIZON, given.share_left, given.ask_every, given.align)
    timing = AnswerTiming(1, inference_s, 0.0, Holding("linear"), TICK_S, 1, inference_s)
    slow, tracking, found = SlowLaw(law, timing, rules), Tracking(1), []
    for tick in range(round(seconds / TICK_S)):
        tracking.time_s = tick * TICK_S
        slow.torque(tracking)
        found.append(slow.target(tracking)[0, 0])
    return np.array(found), law, slow


@pytest.mark.parametrize("merge", ["replace", "weighted", "temporal_ensemble", "frozen_prefix"])
def test_perfect_chunks_stay_perfect(merge):
    found, _, slow = run(merge=merge, ask_every=8)
    np.testing.assert_allclose(found, SPEED * TICK_S * np.arange(len(found)), atol=1e-12)
    assert slow.log.summary()["largest"]["jump_rad"] < 1e-12
    assert slow.log.starved()["ticks"] == 0


def test_count_alignment_jumps_back_by_speed_times_delay():
    """The motion of chunks that act 100 ms late is 100 ms behind after each switch."""
    _, _, slow = run(merge="replace", align="count", ask_every=8)
    assert slow.log.summary()["largest"]["jump_rad"] == pytest.approx(SPEED * 0.1, rel=1e-9)


@pytest.mark.parametrize(("share", "executed"), [(1.0, 3), (0.5, 8), (0.25, 12)])
def test_law_is_asked_when_a_share_of_its_actions_is_left(share, executed):
    """At share 1 as soon as an answer is there: 100 ms are less than three actions."""
    _, law, _ = run(merge="replace", ask_when=share)
    between_s = np.diff(law.asked_s)[2:]
    expected_s = 0.1 if share == 1.0 else (executed - 1) * ACTION_S
    np.testing.assert_allclose(between_s, expected_s, atol=TICK_S)


def test_age_of_an_observation_is_at_most_delay_and_executed_actions():
    _, _, slow = run(merge="replace", ask_every=8)
    ages = slow.log.summary()["age_ms"]
    assert ages["largest"] == pytest.approx(100.0 + 8 * 40.0, abs=1.0)


def test_synchronous_waits_at_the_end_of_each_chunk():
    """640 ms of motion, 100 ms at rest, and so on: five rests in 4 s."""
    _, law, slow = run(merge="synchronous")
    np.testing.assert_allclose(np.diff(law.asked_s)[1:], 0.74, atol=TICK_S)
    assert slow.log.starved()["ticks"] == pytest.approx(500, abs=5)


def test_policy_is_told_what_it_continues():
    """From the time of the question on: what is left of the old chunk, and three frozen actions."""
    _, law, _ = run(merge="frozen_prefix", ask_every=8)
    prefix, weights, delay_steps = law.told[-1]
    assert (delay_steps, len(weights)) == (3, HORIZON)
    assert prefix[0, 0, 0] == pytest.approx(SPEED * law.asked_s[-1], abs=1e-12)
    assert 1 <= len(prefix) < HORIZON


def test_answer_of_another_length_is_refused():
    class Short(Perfect):
        def target(self, tracking):
            return super().target(tracking)[:12]

    with pytest.raises(ValueError, match=r"12 rows: must be 16, as controller\.chunks\.horizon"):
        run(law=Short(), merge="replace")


@pytest.mark.parametrize(
    ("given", "complaint"),
    [
        ({"merge": "replac"}, "did you mean"),
        ({"ask_when": 0.5, "ask_every": 4}, "ask_when must be left out with ask_every"),
        (
            {"merge": "replace", "weighted": {"new_weight": 1.0}},
            "weighted must be left out with merge replace",
        ),
        ({"merge": "synchronous", "ask_when": 0.5}, "must be left out with synchronous"),
        ({"ask_when": 0.0}, "greater than 0"),
    ],
)
def test_settings_without_effect_are_refused(given, complaint):
    with pytest.raises(ValueError, match=complaint):
        ChunksConfiguration.model_validate(given)


@pytest.mark.parametrize("merge", ["replace", "weighted", "temporal_ensemble"])
def test_answers_of_one_row_are_not_averaged(merge):
    """A row is meant for its own time, and only goes on acting until the next one."""
    _, rule = merge_of(merge=merge, horizon=1)
    acting = answer(0.0, [0.0])
    for number in range(1, 300):
        acting = rule.merged(acting, answer(number * ACTION_S, [number]), number * ACTION_S)
        assert positions(acting) == [number]
