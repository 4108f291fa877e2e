"""What the control loop sends: torques within limits, targets, and how the law came to them."""

import numpy as np
import pytest
from loop_bench import MS, OFFSET, SWING, Bench, Spectator, predicting, state, status

from bus_schema.messages import topics
from bus_schema.messages.types import JOINT_STATE, TYPESTORE
from controller.errors import LawError


def test_control_status_has_the_diagnostics_of_the_law():
    bench = Bench("fixed_time_neural")
    bench.send(0)
    ((_, _, sequence),) = bench.send(100 * MS, 0.5 * OFFSET)
    record = bench.last(topics.CONTROL_STATUS)
    fields = record.fields
    rows = np.empty((3, 3))
    SWING.evaluate(0.1, *rows)
    upper, lower = bench.funnel.bounds(np.array([0.1]))
    assert record.stamp_ns == 100 * MS
    assert fields["sequence"][0] == sequence == 2
    np.testing.assert_array_equal(fields["reference_position"], rows[0])
    np.testing.assert_array_equal(fields["reference_velocity"], rows[1])
    np.testing.assert_allclose(fields["error"], 0.5 * OFFSET, atol=1e-15)
    np.testing.assert_array_equal(fields["error_rate"], -rows[1])
    np.testing.assert_allclose(fields["upper_bound"], upper[0], rtol=1e-14)
    np.testing.assert_allclose(fields["lower_bound"], lower[0], rtol=1e-14)
    error, above, below = fields["error"], fields["upper_bound"], -fields["lower_bound"]
    expected = 0.5 * np.log((1 + error / below) / (1 - error / above))
    np.testing.assert_allclose(fields["transformed_error"], expected, rtol=1e-12)
    for name in ("sliding_variable", "network_output", "network_norm"):
        assert np.isfinite(fields[name]).all()
        assert fields[name].any()  # a joint whose torque was saturated has learned nothing yet


def test_missing_diagnostics_are_nan():
    bench = Bench("pid")
    bench.send(0)
    fields = bench.last(topics.CONTROL_STATUS).fields
    for name in ("transformed_error", "sliding_variable", "network_output", "network_norm"):
        assert np.isnan(fields[name]).all()


def test_sent_torques_are_limited():
    bench = Bench()
    ((_, torque, _),) = bench.send(0, error=np.array([100.0, -100.0, 100.0]))
    assert torque == [-400.0, 700.0, -300.0]


def test_rate_limit_uses_the_time_between_stamps():
    bench = Bench(rate_limit=1000.0)
    ((_, first, _),) = bench.send(0)
    ((_, second, _),) = bench.send(20 * MS, -OFFSET)
    # 1000 N m/s over 20 ms.
    np.testing.assert_allclose(np.abs(np.subtract(second, first)), 20.0, rtol=1e-12)


def test_targets_without_foresight_are_the_reference():
    bench = Bench(sends_targets=True)
    bench.send(100 * MS, start_ns=0)
    rows = np.empty((3, 3))
    SWING.evaluate(0.1, *rows)
    np.testing.assert_array_equal(bench.targets, [rows[:2]])


def test_targets_with_foresight_lead_to_the_state_foreseen():
    bench = Bench(compensation=predicting(20 * MS), sends_targets=True)
    bench.send(0)
    ((position, velocity),) = bench.targets
    seen = bench.compensation.predicted
    np.testing.assert_allclose(position + 0.020 * velocity, seen.position, rtol=1e-14)
    np.testing.assert_array_equal(velocity, seen.velocity)


def test_commands_without_targets_have_none():
    bench = Bench(compensation=predicting())
    bench.send(0)
    assert bench.targets == []
    payload = next(payload for topic, payload in bench.received if topic is topics.JOINT_COMMANDS)
    message = TYPESTORE.deserialize_cdr(payload, JOINT_STATE)
    assert (message.position.size, message.velocity.size, message.effort.size) == (0, 0, 3)


@pytest.mark.parametrize(
    ("target", "complaint"),
    [
        (np.zeros(3), r"targets have shape \(3,\): must be \(2, 3\)"),
        (np.full((2, 3), np.nan), "finite"),
    ],
)
def test_targets_of_a_law_are_checked_before_the_run(target, complaint):
    law = Spectator()
    law.target = lambda _tracking: target
    with pytest.raises(LawError, match=f"failed before the first tick: .*{complaint}"):
        Bench(own_law=law, sends_targets=True).loop.warm_up()


def test_a_controller_that_stops_sends_no_target():
    bench = Bench(own_law=Spectator(), compensation=predicting(), sends_targets=True)
    bench.send(0)
    assert np.isfinite(bench.targets).all()
    bench.law.fails = True
    bench.plant.send_state(state(MS, bench.at(MS)), status(MS))
    ((stamp_ns, torque, _),) = bench.answers()
    assert (stamp_ns, torque) == (MS, [0.0, 0.0, 0.0])
    assert np.isnan(bench.targets).all()
