"""The control loop answers each state, and takes its time from the plant."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from loop_bench import MS, NAMES, OFFSET, ROBOT, SWING, Bench, Spectator, state, status

from bus_schema.messages import topics
from bus_schema.messages.record import Record
from tests.joint_states import joint_state


def test_first_state_is_answered_at_its_own_stamp_with_a_torque_against_the_error():
    bench = Bench()
    ((stamp_ns, torque, sequence),) = bench.send(5 * MS)
    assert stamp_ns == 5 * MS
    assert sequence == 1
    assert (np.array(torque) * OFFSET < 0.0).all()
    assert (bench.loop.cycles, bench.loop.late) == (1, 0)


def test_first_state_integrates_nothing():
    # No step has passed: PID at the first state is −K_p e − K_d ė alone.
    bench = Bench()
    ((_, torque, _),) = bench.send(700 * MS)
    gains = bench.law.gains
    rows = np.empty((3, 3))
    SWING.evaluate(0.7, *rows)
    expected = -(gains.proportional * OFFSET + gains.derivative * (0.0 - rows[1]))
    limits = ROBOT.effort_limits_nm
    np.testing.assert_allclose(torque, np.clip(expected, -limits, limits), rtol=1e-12)


def test_step_after_an_absence_of_states_is_none_where_a_task_says_how_long_that_is():
    bench = Bench(own_law=(law := Spectator()), longest_step_s=0.016)
    for stamp_ms in (0, 1, 17, 34, 35):
        bench.send(stamp_ms * MS)
    np.testing.assert_allclose(law.steps_s, [0.0, 0.001, 0.016, 0.0, 0.001])


@settings(max_examples=25)
@given(stamps=st.lists(st.integers(0, 10**12), min_size=1, max_size=20))
def test_every_answer_echoes_the_stamp_of_its_state(stamps):
    bench = Bench()
    assert [answer[0] for stamp in stamps for answer in bench.send(stamp)] == stamps
    assert bench.loop.cycles + bench.loop.late == len(stamps)


@pytest.mark.parametrize("stamp_ns", [9 * MS, 10 * MS, 0])
def test_late_and_duplicate_states_get_the_torque_in_force(stamp_ns):
    bench = Bench("fixed_time_neural")
    bench.send(9 * MS)
    ((_, in_force, _),) = bench.send(10 * MS, 0.9 * OFFSET)
    ((echoed_ns, torque, sequence),) = bench.send(stamp_ns, -OFFSET)
    assert echoed_ns == stamp_ns
    assert torque == in_force
    assert sequence == 3
    assert (bench.loop.cycles, bench.loop.late) == (2, 1)


def test_states_that_come_after_the_end_are_not_answered():
    bench = Bench()
    assert len(bench.send(0)) == 1
    bench.loop.end()
    assert bench.send(MS) == []


@pytest.mark.parametrize("law", ["pid", "fixed_time_neural"])
def test_late_states_change_nothing_in_the_law(law):
    disturbed, quiet = Bench(law), Bench(law)
    for bench in (disturbed, quiet):
        bench.send(1 * MS)
        bench.send(3 * MS, 0.9 * OFFSET)
    disturbed.send(2 * MS, -OFFSET)
    disturbed.send(3 * MS, -OFFSET)
    after = [bench.send(4 * MS, 0.8 * OFFSET)[0][1] for bench in (disturbed, quiet)]
    assert after[0] == after[1]


@pytest.mark.parametrize("wrong", [state(MS, -OFFSET), state(9 * MS, (np.nan, 0.0, 0.0))])
def test_late_and_invalid_states_leave_the_tracked_situation(wrong):
    bench = Bench()
    bench.send(3 * MS)
    before = bench.loop.tracking.motion.copy()
    bench.plant.send_state(wrong, status(MS))
    np.testing.assert_array_equal(bench.loop.tracking.motion, before)


def test_unusable_states_are_ignored_and_counted():
    bench, silent = Bench(), []
    bench.send(0)
    names = ("base_yaw", "shoulder", "wrist")
    stranger = Record(topics.layout(topics.JOINT_STATES, names)).payload()
    no_time = Record(topics.layout(topics.JOINT_STATES, NAMES))
    no_time.fields["header.stamp.nanosec"][0] = 10**9
    for payload in (
        b"", b"garbage", stranger, no_time.payload(), joint_state(NAMES, np.zeros(3), stamp_ns=1),
        state(MS, (np.nan, 0.0, 0.0)), state(MS, (0.0, 0.0, 0.0), (0.0, np.inf, 0.0)),
    ):  # fmt: skip
        bench.plant.send_state(payload, status(MS))
        silent += bench.answers()
    assert silent == []
    assert bench.loop.rejections.counts == {"malformed": 3, "wrong_names": 1, "not_finite": 3}
    assert bench.loop.cycles == 1
    assert len(bench.send(MS)) == 1  # none of their stamps counted


def test_time_starts_where_the_plant_says_it_does():
    bench = Bench()
    start_ns = 3_000_000_500
    bench.send(start_ns + 100 * MS, start_ns=start_ns)
    expected = bench.at(100 * MS)
    np.testing.assert_array_equal(
        bench.last(topics.CONTROL_STATUS).fields["reference_position"], expected
    )


def test_foreign_plant_without_status_starts_time_at_its_first_stamp():
    bench, first_ns = Bench(), 86_400 * 1_000_000_000
    for elapsed_ns in (0, MS, 250 * MS):
        bench.loop.cycle(state(first_ns + elapsed_ns, bench.at(elapsed_ns) + OFFSET), None)
        ((stamp_ns, torque, _),) = bench.answers()
        assert stamp_ns == first_ns + elapsed_ns
        assert np.isfinite(torque).all()
        fields = bench.last(topics.CONTROL_STATUS).fields
        np.testing.assert_array_equal(fields["reference_position"], bench.at(elapsed_ns))
        np.testing.assert_allclose(fields["error"], OFFSET, atol=1e-15)


def test_garbage_status_is_counted_and_the_state_answered():
    bench = Bench()
    bench.loop.cycle(state(7 * MS, bench.at(0)), b"garbage")
    assert len(bench.answers()) == 1
    assert bench.loop.rejections.counts == {"malformed": 1}
    fields = bench.last(topics.CONTROL_STATUS).fields
    np.testing.assert_array_equal(fields["reference_position"], bench.at(0))
