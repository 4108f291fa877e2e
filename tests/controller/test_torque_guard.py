import pickle

import numpy as np
import pytest

from bus_schema.limits import JointLimits
from controller.torque_guard import ControllerError, InvalidTorqueError, TorqueGuard

LIMITS = np.array([400.0, 700.0, 300.0])
UNLIMITED = np.full(3, np.inf)
REST = np.zeros((2, 3))


def guard_of(law, limits):
    return TorqueGuard(law, limits, REST)


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("joint", range(3))
def test_not_finite_torque_is_refused_by_law_and_tick(bad, joint):
    torque = np.zeros(3)
    torque[joint] = bad
    with pytest.raises(InvalidTorqueError, match=r"law pid .* at tick 17") as caught:
        guard_of("pid", JointLimits.of_torques(LIMITS, UNLIMITED)).admit(torque, 17, 1e-3)
    assert (caught.value.law, caught.value.tick) == ("pid", 17)
    assert str(torque.tolist()) in str(caught.value)
    assert isinstance(caught.value, ControllerError)
    assert isinstance(caught.value, ArithmeticError)


@pytest.mark.parametrize(
    "wrong",
    [
        np.zeros(2), np.zeros(4), np.zeros((3, 1)), np.float64(0.0), [0.0, 0.0, 0.0], None,
        memoryview(np.zeros(3)), np.zeros(3, np.float32),
    ],
)  # fmt: skip
def test_what_is_no_array_of_three_doubles_is_refused_by_law_and_tick(wrong):
    with pytest.raises(InvalidTorqueError, match=r"law smc .* is expected at tick 4"):
        guard_of("smc", JointLimits.of_torques(LIMITS, UNLIMITED)).admit(wrong, 4, 1e-3)


def test_refused_torque_leaves_the_rate_limit_where_it_was():
    guard = guard_of("pid", JointLimits.of_torques(LIMITS, np.full(3, 10.0)))
    guard.admit(np.full(3, 50.0), 0, 0.0)
    with pytest.raises(InvalidTorqueError):
        guard.admit(np.array([0.0, 0.0, np.nan]), 1, 1.0)
    assert guard.admit(np.zeros(3), 2, 1.0).tolist() == [40.0, 40.0, 40.0]


class Subclass(np.ndarray):
    """An array that compiled code does not take."""


@pytest.mark.parametrize(
    "own",
    [np.zeros(3), np.zeros(6)[::2], np.zeros((3, 2), order="F")[:, 0], np.zeros(3).view(Subclass)],
    ids=["plain", "strided", "column", "subclass"],
)
def test_law_that_returns_one_array_over_and_over_is_limited_and_checked_each_time(own):
    guard = guard_of("pid", JointLimits.of_torques(LIMITS, np.full(3, 100.0)))
    reported = []
    for torque in (0.0, 50.0, 1000.0):
        own[:] = torque
        reported.append(guard.admit(own, 0, 1.0).tolist())
        assert own.tolist() == [torque] * 3  # what the law keeps there stays its own
    assert reported == [[0.0] * 3, [50.0] * 3, [150.0] * 3]
    own[1] = np.nan
    with pytest.raises(InvalidTorqueError, match=r"nan.* at tick 7"):
        guard.admit(own, 7, 1.0)
    own[1] = 0.0
    # Another array of the law's may come at any time, right or wrong.
    assert guard.admit(np.full(3, 200.0), 8, 1.0).tolist() == [200.0, 200.0, 200.0]
    with pytest.raises(InvalidTorqueError, match=r"returned \(2,\)"):
        guard.admit(own[:2], 9, 1.0)
    own[:] = 300.0
    assert guard.admit(own, 10, 1.0).tolist() == [300.0, 300.0, 300.0]


def test_read_only_array_of_a_law_is_accepted():
    torque = np.full(3, 5.0)
    torque.setflags(write=False)
    guard = guard_of("pid", JointLimits.of_torques(LIMITS, UNLIMITED))
    assert [guard.admit(torque, tick, 1.0).tolist() for tick in range(2)] == [[5.0] * 3] * 2


def test_all_spellings_of_float64_are_accepted():
    # As of gains that a law has unpickled: NumPy's float64 is not always the same object.
    torque = pickle.loads(pickle.dumps(np.full(3, 5.0)))
    guard = guard_of("pid", JointLimits.of_torques(LIMITS, UNLIMITED))
    assert guard.admit(torque, 0, 1.0).tolist() == [5.0] * 3
