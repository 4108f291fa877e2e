"""What all control laws share."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bus_schema.robot_description import load_robot
from controller.configuration import ControllerConfiguration
from controller.control_law import D_LOWER, D_UPPER, DD_LOWER, DD_UPPER, LOWER, UPPER, Tracking
from controller.laws import LAWS
from controller.prescribed_performance import performance_function
from deploy.robot_files import find_urdf

JOINTS = 3
ROBOT = load_robot(find_urdf("paper_arm", Path()))
SETTINGS = settings(deadline=None, max_examples=60)
all_laws = pytest.mark.parametrize("name", LAWS)


def law_of(name, order=(0, 1, 2)):
    """A fresh law with the gains of the paper's arm, joints in this order."""
    configuration = ControllerConfiguration(law=name)
    gains = configuration.build_gains(ROBOT, np.zeros(JOINTS))
    vectors = {
        key: value[list(order)]
        for key, value in gains._asdict().items()
        if isinstance(value, np.ndarray)
    }
    return configuration.build_law(gains._replace(**vectors))


def situation(errors, error_rates, time_s=0.0, step_s=1e-3, order=(0, 1, 2)):
    """Errors in a funnel that differs from joint to joint and from side to side."""
    tracking, order = Tracking(JOINTS), list(order)
    tracking.time_s, tracking.step_s = time_s, step_s
    tracking.error[:] = np.asarray(errors)[order]
    tracking.error_rate[:] = np.asarray(error_rates)[order]
    tracking.position[:] = tracking.error
    tracking.velocity[:] = tracking.error_rate
    for rows, openings in (
        ((UPPER, D_UPPER, DD_UPPER), np.array([0.3, 0.1, 1.0])),
        ((LOWER, D_LOWER, DD_LOWER), np.array([0.1, 0.4, 0.9])),
    ):
        bounds = [performance_function(time_s, opening, 0.01, 4.0) for opening in openings]
        tracking.bounds[list(rows)] = np.array(bounds).T[:, order]
    return tracking


def per_joint(largest):
    values = st.one_of(st.floats(-largest, largest), st.floats(-0.3, 0.3), st.just(0.0))
    return st.tuples(values, values, values)


@all_laws
@SETTINGS
@given(
    errors=per_joint(1e30), error_rates=per_joint(1e30),
    time_s=st.floats(0.0, 1e3), step_s=st.floats(0.0, 0.1),
)  # fmt: skip
def test_torque_is_finite_for_any_error(name, errors, error_rates, time_s, step_s):
    # 1e30 rad is far outside any funnel; its power of 1.4 is still a number.
    torque = law_of(name).torque(situation(errors, error_rates, time_s, step_s))
    assert torque.shape == (JOINTS,)
    assert np.isfinite(torque).all()


@all_laws
@SETTINGS
@given(
    motion=st.lists(st.tuples(per_joint(1e3), per_joint(1e4)), min_size=1, max_size=30),
    step_s=st.floats(1e-4, 1e-2),
)
def test_torque_stays_finite_over_a_wild_motion(name, motion, step_s):
    law = law_of(name)
    for tick, (errors, error_rates) in enumerate(motion):
        tracking = situation(errors, error_rates, tick * step_s, step_s)
        assert np.isfinite(law.torque(tracking)).all()


@all_laws
@pytest.mark.parametrize("time_s", [0.0, 0.1, 10.0])
def test_fresh_law_gives_no_torque_at_zero_error(name, time_s):
    # Also while the bounds shrink, and shrink unequally: zero error is zero transformed error.
    torque = law_of(name).torque(situation(np.zeros(3), np.zeros(3), time_s))
    assert torque.tolist() == [0.0, 0.0, 0.0]


@all_laws
@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize("size", [1e-3, 0.2, 5.0])
def test_torque_opposes_an_error_on_either_side_and_outside(name, sign, size):
    torque = law_of(name).torque(situation(np.full(3, sign * size), np.zeros(3), time_s=10.0))
    assert (torque * sign < 0.0).all()


@all_laws
@SETTINGS
@given(
    motion=st.lists(st.tuples(per_joint(0.5), per_joint(5.0)), min_size=2, max_size=8),
    order=st.permutations(range(JOINTS)),
)
def test_relabelling_the_joints_relabels_the_torques(name, motion, order):
    law, relabelled = law_of(name), law_of(name, order)
    for tick, (errors, error_rates) in enumerate(motion):
        expected = law.torque(situation(errors, error_rates, 1e-3 * tick))[list(order)]
        torque = relabelled.torque(situation(errors, error_rates, 1e-3 * tick, order=order))
        assert torque.tolist() == expected.tolist()


@all_laws
def test_gains_differ_between_joints_so_that_relabelling_can_fail(name):
    torque = law_of(name).torque(situation(np.full(3, 0.05), np.zeros(3), time_s=10.0))
    assert len(set(torque.tolist())) == JOINTS


@all_laws
@SETTINGS
@given(motion=st.lists(st.tuples(per_joint(1.0), per_joint(10.0)), min_size=1, max_size=10))
def test_reset_law_repeats_itself_bit_for_bit(name, motion):
    def run():
        return [
            law.torque(situation(errors, error_rates, 1e-3 * tick)).tobytes()
            for tick, (errors, error_rates) in enumerate(motion)
        ]

    law = law_of(name)
    first = run()
    law.reset()
    assert run() == first
    law = law_of(name)
    assert run() == first


@all_laws
def test_law_remembers_so_that_reset_matters(name):
    law, tracking = law_of(name), situation(np.full(3, 0.05), np.zeros(3))
    first = law.torque(tracking).copy()
    assert law.torque(tracking).tolist() != first.tolist()


@all_laws
def test_law_takes_all_its_time_from_the_situation(name):
    # A step of zero, as at the first state of a run, must not change the memory.
    law, tracking = law_of(name), situation(np.full(3, 0.05), np.zeros(3), step_s=0.0)
    first = law.torque(tracking).copy()
    assert law.torque(tracking).tolist() == first.tolist()


@all_laws
def test_law_does_not_write_into_the_situation(name):
    tracking = situation((0.1, -0.2, 5.0), (1.0, -2.0, 3.0))
    before = {key: np.copy(value) for key, value in vars(tracking).items()}
    law_of(name).torque(tracking)
    for key, value in vars(tracking).items():
        np.testing.assert_array_equal(value, before[key], err_msg=key)
