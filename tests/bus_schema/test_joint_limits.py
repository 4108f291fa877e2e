import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from bus_schema.limits import (
    Hit,
    JointLimits,
    LimitCounts,
    LimitsConfiguration,
    limit_torques,
    name_of,
)
from tests.arms import PAPER_ARM as ROBOT

REST = np.zeros((2, 3))


def limits_of(**changes):
    values = {
        "torque_nm": np.full(3, 10.0),
        "torque_rate_nm_s": np.full(3, np.inf),
        "lower_rad": np.full(3, -1.0),
        "upper_rad": np.full(3, 1.0),
        "velocity_rad_s": np.full(3, 2.0),
    }
    return JointLimits(**(values | changes))


def limited(wanted, motion=REST, before=(0.0, 0.0, 0.0), step_s=0.001, **changes):
    out = np.array(before, dtype=float)
    motion = np.array(motion, dtype=float)
    hits = limit_torques(np.array(wanted), motion, limits_of(**changes).packed(), out, step_s)
    return out.tolist(), Hit(hits)


BEYOND = [[1.1, -1.1, 1.1], [0.0, 0.0, 0.0]]
FAST = [[0.0, 0.0, 0.0], [2.1, -2.1, 2.1]]
INWARDS = [4.0, -4.0, -4.0]


@pytest.mark.parametrize(
    ("wanted", "motion", "changes", "torque", "hits"),
    [
        ([9.0, -10.0, 0.0], [[1.0, -1.0, 0.0], [2.0, -2.0, 0.0]], {}, [9.0, -10.0, 0.0], Hit(0)),
        ([11.0, -11.0, 3.0], REST, {}, [10.0, -10.0, 3.0], Hit.TORQUE),
        (INWARDS, BEYOND, {}, [0.0, 0.0, -4.0], Hit.POSITION),
        (INWARDS, BEYOND, {"cuts_position": False}, INWARDS, Hit.POSITION),
        (INWARDS, FAST, {"cuts_velocity": True}, [0.0, 0.0, -4.0], Hit.VELOCITY),
        (INWARDS, FAST, {}, INWARDS, Hit.VELOCITY),  # only counted
    ],
    ids=["within", "clipped", "beyond the range", "counted", "too fast", "counted too"],
)
def test_torque_is_limited_and_the_limit_is_named(wanted, motion, changes, torque, hits):
    assert limited(wanted, motion, **changes) == (torque, hits)


def test_change_of_torque_is_limited_by_the_time_since_the_last():
    rates = {"torque_rate_nm_s": np.full(3, 1000.0)}
    assert limited([5.0, -5.0, 0.5], step_s=0.002, **rates) == ([2.0, -2.0, 0.5], Hit.TORQUE_RATE)
    assert limited([5.0, -5.0, 0.5], step_s=0.0, **rates) == ([5.0, -5.0, 0.5], Hit(0))


def test_cut_goes_before_the_limit_of_change():
    rates = {"torque_rate_nm_s": np.full(3, 1000.0)}
    beyond = [[1.1, 0.0, 0.0], [0.0, 0.0, 0.0]]
    torque, hits = limited([8.0, 8.0, 8.0], beyond, before=(8.0, 8.0, 8.0), **rates)
    assert torque == [0.0, 8.0, 8.0]
    assert hits == Hit.POSITION


@given(
    st.tuples(*[st.floats(-1e300, 1e300)] * 3),
    st.tuples(*[st.floats(-10, 10)] * 3),
    st.tuples(*[st.floats(-1e3, 1e3)] * 6),
)
def test_no_torque_ever_exceeds_its_limit(wanted, before, motion):
    motion = np.array(motion).reshape(2, 3)
    torque, _ = limited(wanted, motion, before, torque_rate_nm_s=np.full(3, 1e3))
    assert np.abs(torque).max() <= 10.0


def test_limits_come_from_the_urdf_and_the_scenario_wins():
    plain = LimitsConfiguration().of_plant(ROBOT)
    assert plain.torque_nm.tolist() == [400.0, 700.0, 300.0]
    assert plain.velocity_rad_s.tolist() == [6.0, 6.0, 6.0]
    assert plain.upper_rad.tolist() == [3.1, 1.6, 3.0]
    assert np.isinf(plain.torque_rate_nm_s).all()
    given = LimitsConfiguration(torque_nm=[1, 2, 3], velocity_rad_s=4).of_plant(ROBOT)
    assert given.torque_nm.tolist() == [1.0, 2.0, 3.0]
    assert given.velocity_rad_s.tolist() == [4.0, 4.0, 4.0]


def test_controller_keeps_the_margins_and_its_own_rate():
    configuration = LimitsConfiguration(
        position_margin_rad=[0.1, 0.2, 0.3], velocity_margin=0.5, torque_rate_nm_s=[50, 500, 5000]
    )
    own = configuration.of_controller(ROBOT, np.full(3, 400.0))
    np.testing.assert_allclose(own.upper_rad, [3.0, 1.4, 2.7])
    np.testing.assert_allclose(own.lower_rad, [-3.0, -2.9, -2.7])
    assert own.velocity_rad_s.tolist() == [3.0, 3.0, 3.0]
    assert own.torque_rate_nm_s.tolist() == [50.0, 400.0, 400.0]


def test_what_is_hit_is_counted_and_new_only_once():
    counts = LimitCounts()
    both = Hit.TORQUE | Hit.VELOCITY
    assert [counts.note(hits) for hits in (Hit.TORQUE, both, both, Hit.TORQUE)] == [
        Hit.TORQUE, Hit.VELOCITY, Hit(0), Hit(0),
    ]  # fmt: skip
    assert counts.summary() == {"torque": 4, "torque_rate": 0, "position": 0, "velocity": 2}
    assert name_of(both) == "torque, velocity"
