"""A law that is asked less often than the loop runs, and whose answers take their time."""

from __future__ import annotations

import numpy as np
import pytest

from controller.chunks.answer import Holding
from controller.control_law import Diagnostics, Tracking
from controller.slow_law import AnswerTiming, SlowLaw
from deploy.judge.metrics import summarise
from deploy.run.simulate import simulate
from deploy.scenario.scenario import load_setup

PERIOD_S = 0.001


class Counting:
    """Answers with how often it was asked; in chunks, if it is to."""

    def __init__(self, rows=None):
        self.diagnostics, self._rows = Diagnostics(1), rows
        self.reset()

    def reset(self):
        self.asked = 0

    def torque(self, tracking):
        self.asked += 1
        if self._rows is None:
            return np.array([float(self.asked)])
        return self.asked + np.arange(self._rows)[:, None] / 10.0

    def target(self, tracking):
        return np.array([[tracking.time_s], [2.0]])


def answers(
    law, ticks, between="hold", every=1, inference_ms=0.0, jitter_ms=0.0, first_ms=None,
    keeps_velocity=False,
):  # fmt: skip
    """Torques and targets at each tick."""
    timing = AnswerTiming(
        every, 1e-3 * inference_ms, 1e-3 * jitter_ms, Holding(between, keeps_velocity), PERIOD_S,
        seed=1,
        first_s=1e-3 * (inference_ms if first_ms is None else first_ms),
    )  # fmt: skip
    slow, tracking = SlowLaw(law, timing), Tracking(1)
    torques, targets = [], []
    for tick in range(ticks):
        tracking.time_s = tick * PERIOD_S
        torques.append(float(slow.torque(tracking)[0]))
        targets.append(slow.target(tracking)[:, 0].tolist())
    return torques, targets


def test_law_is_asked_at_every_third_state_and_held_in_between():
    assert answers(Counting(), 7, every=3)[0] == [1, 1, 1, 2, 2, 2, 3]


def test_answer_acts_after_its_inference_time_and_the_first_at_once():
    # Asked at ticks 0, 2, 4; the answer of tick 2 acts at tick 4, where the next is asked.
    assert answers(Counting(), 7, every=2, inference_ms=2.0)[0] == [1, 1, 1, 1, 2, 2, 3]


def test_nothing_is_asked_while_a_question_is_open():
    # Asked at tick 0 and 1; the second answer is there at tick 4, where the third is asked.
    assert answers(Counting(), 8, inference_ms=3.0)[0] == [1, 1, 1, 1, 2, 2, 2, 3]


def test_rows_of_a_chunk_are_for_the_next_ticks_and_the_last_is_held():
    assert answers(Counting(rows=2), 4, every=4)[0] == [1.0, 1.1, 1.1, 1.1]


def test_targets_stay_or_go_on_at_their_velocity():
    held = answers(Counting(), 3, every=3)[1]
    assert held == [[0.0, 0.0]] * 3
    moved = answers(Counting(), 3, "linear", every=3)[1]
    np.testing.assert_allclose(moved, [[0.0, 2.0], [0.002, 2.0], [0.004, 2.0]])


def test_held_targets_of_a_robot_that_takes_velocities_keep_them():
    held = answers(Counting(), 3, every=3, keeps_velocity=True)[1]
    assert held == [[0.0, 2.0]] * 3


@pytest.mark.parametrize(
    ("torques", "targets", "complaint"),
    [
        (
            np.zeros(2),
            np.zeros((2, 1)),
            r"torques have shape \(2,\): must be \(1,\), or",
        ),
        (np.zeros((0, 1)), np.zeros((2, 1)), r"torques have shape \(0, 1\)"),
        ([[1.0], [np.nan]], np.zeros((2, 1)), r"torques\[1, 0\] = nan: must be finite"),
        (np.zeros(1), np.zeros(1), r"targets have shape \(1,\): must be \(2, 1\)"),
        (np.zeros(1), np.zeros((5, 1, 1)), r"targets have shape \(5, 1, 1\)"),
        (np.zeros(1), [[np.inf], [0.0]], r"targets\[0, 0, 0\] = inf: must be finite"),
    ],
)
def test_answers_of_a_wrong_shape_or_without_a_number_are_refused(torques, targets, complaint):
    law = Counting()
    law.torque, law.target = (lambda _tracking: torques), (lambda _tracking: targets)
    with pytest.raises(ValueError, match=complaint):
        answers(law, 1, every=2)


def test_inference_times_repeat_after_a_reset():
    law = Counting()
    timing = AnswerTiming(2, 0.003, 0.002, Holding(), PERIOD_S, seed=1, first_s=0.003)
    slow, tracking, runs = SlowLaw(law, timing), Tracking(1), []
    for _ in range(2):
        torques = []
        for tick in range(50):
            tracking.time_s = tick * PERIOD_S
            torques.append(float(slow.torque(tracking)[0]))
        slow.reset()
        runs.append(torques)
    assert runs[0] == runs[1]
    assert len(set(np.diff(np.flatnonzero(np.diff(runs[0]))).tolist())) > 1  # they vary


@pytest.mark.parametrize(("inference_ms", "verdict"), [(5, "kept"), (60, "lost")])
def test_whole_run_keeps_its_bounds_until_inference_takes_too_long(inference_ms, verdict):
    words = ["controller.law=smc", "controller.every=5", "duration_s=1", "metrics.from_s=0.5",
             f"controller.inference_ms={inference_ms}"]  # fmt: skip
    run = simulate(load_setup("paper_arm", words)).data()
    assert summarise(run)["verdict"] == verdict


def test_law_may_have_data_called_target():
    law = Counting()
    law.target = np.zeros(1)
    assert answers(law, 2, every=2)[0] == [1, 1]


def test_first_inference_in_motion_takes_its_own_time():
    # Asked at ticks 0, 1 and 5; the answer of tick 1 acts at tick 5, the next two ticks later.
    answered = answers(Counting(), 9, inference_ms=2.0, first_ms=4.0)[0]
    assert answered == [1, 1, 1, 1, 1, 2, 2, 3, 3]


def test_first_inference_alone_makes_a_law_slow():
    slow = load_setup("paper_arm", ["duration_s=0.1", "controller.first_inference_ms=40"])
    as_others = ["controller.inference_ms=5", "controller.first_inference_ms=5"]
    same = load_setup("paper_arm", ["duration_s=0.1", *as_others])
    default = load_setup("paper_arm", ["duration_s=0.1", as_others[0]])
    digests = [simulate(setup).data().digest for setup in (slow, same, default)]
    assert digests[1] == digests[2] != digests[0]
    assert digests[0] != simulate(load_setup("paper_arm", ["duration_s=0.1"])).data().digest
