"""What all control laws share."""

from functools import cache

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from controller.configuration import ControllerConfiguration
from controller.control_law import D_LOWER, D_UPPER, DD_LOWER, DD_UPPER, LOWER, UPPER, Tracking
from controller.funnel import Funnel, performance_function
from controller.laws import LAWS, TORQUE_LAWS
from controller.manipulator_model import ManipulatorModel
from controller.reference import JointSinusoids
from tests.arms import PAPER_ARM, forward_dynamics, runge_kutta

JOINTS = 3
ROBOT = PAPER_ARM
INERTIA = ManipulatorModel(ROBOT).governing_inertia(np.zeros((1, JOINTS)))
NO_LIMITS = np.full(JOINTS, np.inf)
SETTINGS = settings(max_examples=25)
all_laws = pytest.mark.parametrize("name", TORQUE_LAWS)
laws_with_memory = pytest.mark.parametrize(
    "name",
    [
        "fixed_time_neural",
        "fixed_time_adaptive",
        "pid",
        "pid_gravity",
        "computed_torque",
        "super_twisting",
        "time_delay_control",
    ],
)
MODEL_BASED = (
    "fixed_time_model_based", "smc", "tsmc", "ftsmc", "super_twisting", "computed_torque",
    "slotine_li",
)  # fmt: skip
model_based_laws = pytest.mark.parametrize("name", MODEL_BASED)
laws_with_a_switch = pytest.mark.parametrize("name", ["smc", "tsmc", "ftsmc"])


class DecoupledModel:
    """Three joints that turn about vertical axes of their own: M diagonal, C and G zero."""

    joints = JOINTS

    def __init__(self, order):
        self.inertia = np.array([6.0, 11.0, 1.0])[list(order)]

    def inverse_dynamics(self, position, velocity, acceleration):
        return self.inertia * acceleration

    def torque_along(self, position, velocity, along_velocity, acceleration):
        return self.inertia * acceleration

    def inertial_parameters(self):
        return self.inertia

    def regressor(self, position, velocity, along_velocity, acceleration):
        return np.diag(acceleration)


@cache
def gains_of(name):
    """Gains derived for the paper's arm, which takes longer than all else that a test does."""
    return ControllerConfiguration(law=name).build_gains(ROBOT, INERTIA)


def law_of(name, order=(0, 1, 2), model=None):
    """A fresh law with the gains of the paper's arm, joints in this order."""
    gains = gains_of(name)
    vectors = {
        key: value[list(order)]
        for key, value in gains._asdict().items()
        if isinstance(value, np.ndarray)
    }
    return LAWS[name].build(gains._replace(**vectors), model or DecoupledModel(order), NO_LIMITS)


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


# To draw an example takes longer than to try it, so that each is tried with every law.


@SETTINGS
@given(
    errors=per_joint(1e30), error_rates=per_joint(1e30),
    time_s=st.floats(0.0, 1e3), step_s=st.floats(0.0, 0.1),
)  # fmt: skip
def test_torque_is_finite_for_any_error(errors, error_rates, time_s, step_s):
    # 1e30 rad is far outside any funnel; its power of 1.4 is still a number.
    for name in TORQUE_LAWS:
        torque = law_of(name).torque(situation(errors, error_rates, time_s, step_s))
        assert torque.shape == (JOINTS,), name
        assert np.isfinite(torque).all(), name


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


@SETTINGS
@given(
    motion=st.lists(st.tuples(per_joint(0.5), per_joint(5.0)), min_size=2, max_size=8),
    order=st.permutations(range(JOINTS)),
)
def test_relabelling_the_joints_relabels_the_torques(motion, order):
    for name in TORQUE_LAWS:
        law, relabelled = law_of(name), law_of(name, order)
        for tick, (errors, error_rates) in enumerate(motion):
            expected = law.torque(situation(errors, error_rates, 1e-3 * tick))[list(order)]
            torque = relabelled.torque(situation(errors, error_rates, 1e-3 * tick, order=order))
            assert torque.tolist() == expected.tolist(), name


@SETTINGS
@given(motion=st.lists(st.tuples(per_joint(1.0), per_joint(10.0)), min_size=1, max_size=10))
def test_reset_law_repeats_itself_bit_for_bit(motion):
    def run(law):
        return [
            law.torque(situation(errors, error_rates, 1e-3 * tick)).tobytes()
            for tick, (errors, error_rates) in enumerate(motion)
        ]

    for name in TORQUE_LAWS:
        law = law_of(name)
        first = run(law)
        law.reset()
        assert run(law) == first, name
        assert run(law_of(name)) == first, name


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


@model_based_laws
def test_zero_error_on_a_perfect_model_is_an_equilibrium(name):
    """On the reference the law gives just the torque that keeps the arm on it."""
    model, tracking = ManipulatorModel(ROBOT), situation(np.zeros(3), np.zeros(3), 0.3)
    tracking.position[:] = tracking.reference_position[:] = (0.3, -0.9, 1.2)
    tracking.velocity[:] = tracking.reference_velocity[:] = (0.5, -0.4, 0.7)
    tracking.reference_acceleration[:] = (1.0, -2.0, 3.0)
    torque = law_of(name, model=model).torque(tracking)
    acceleration = forward_dynamics(model, tracking.position, tracking.velocity, torque)
    np.testing.assert_allclose(acceleration, tracking.reference_acceleration, atol=1e-9)


@pytest.mark.parametrize("name", ["fixed_time_model_based", "fixed_time_neural"])
def test_reaching_torque_has_each_gain_with_its_own_power(name):
    """K₁ sig(s)^γ₁ + K₂ sig(s)^γ₂ + K₃ s: all of the torque, of a fresh law without inertia."""
    weightless, gains = DecoupledModel((0, 1, 2)), gains_of(name)
    weightless.inertia = np.zeros(JOINTS)
    law = law_of(name, model=weightless)
    torque = law.torque(situation((0.05, -0.02, 0.5), (1.0, -2.0, 3.0), step_s=0.0))
    s = law.diagnostics.sliding_variable
    size = np.abs(s)
    reaching = gains.k_1 * size**gains.gamma_1 + gains.k_2 * size**gains.gamma_2 + gains.k_3 * size
    np.testing.assert_allclose(torque, -np.sign(s) * reaching, rtol=1e-12)


@laws_with_a_switch
def test_boundary_layer_replaces_the_jump_by_a_line(name):
    gains = ControllerConfiguration(law=name).build_gains(ROBOT, INERTIA)

    def jump(boundary_layer):
        law = LAWS[name].build(
            gains._replace(boundary_layer=boundary_layer), DecoupledModel((0, 1, 2)), NO_LIMITS
        )
        above = law.torque(situation(np.zeros(3), np.full(3, 1e-6))).copy()
        return law.torque(situation(np.zeros(3), np.full(3, -1e-6))) - above

    inertia = DecoupledModel((0, 1, 2)).inertia
    np.testing.assert_allclose(jump(0.0), 2.0 * inertia * gains.switching, rtol=1e-3)
    # within the layer the slope is K / layer; the rest of the law moves by under 1e-3 N m
    np.testing.assert_allclose(jump(0.1), 2e-5 * inertia * gains.switching, atol=5e-3)


@laws_with_memory
def test_memory_stops_outwards_while_a_torque_saturates_and_goes_on_inwards(name):
    gains = ControllerConfiguration(law=name).build_gains(ROBOT, INERTIA)
    still = np.zeros(JOINTS)
    away, back = (situation(np.full(JOINTS, sign * 0.05), still) for sign in (1.0, -1.0))

    def after(limit_nm, *motion):
        """Torque for one and the same error, which differs by what the law remembers."""
        model = DecoupledModel((0, 1, 2))
        law = LAWS[name].build(gains, model, np.full(JOINTS, limit_nm))
        for tracking in motion:
            law.torque(tracking)
        return law.torque(situation(still, still)).copy()

    # the first torque finds nothing saturated, so that one step of it is remembered; no more
    assert after(1e-3, *[away] * 9).tolist() == after(1e-3, away).tolist()
    assert (after(np.inf, *[away] * 9) < after(np.inf, away)).all()
    assert (after(1e-3, away, back) > after(1e-3, away)).all()
    # a joint within its limit is not held by one beyond
    mixed = LAWS[name].build(gains, DecoupledModel((0, 1, 2)), np.array([1e-3, np.inf, np.inf]))
    free = LAWS[name].build(gains, DecoupledModel((0, 1, 2)), NO_LIMITS)
    for _ in range(9):
        torque, expected = mixed.torque(away).copy(), free.torque(away).copy()
    assert torque[0] > expected[0]
    assert torque[1:].tolist() == expected[1:].tolist()


@pytest.mark.parametrize("seed", range(2))
def test_lyapunov_function_of_the_model_based_law_never_grows(seed):
    """V = ½ sᵀ M s along closed-loop runs on a perfect model, the law acting at every RK4 stage."""
    random = np.random.default_rng(seed)
    model = ManipulatorModel(ROBOT)
    law = law_of("fixed_time_model_based", model=model)
    reference = JointSinusoids(np.array([0.2, -0.8, 1.2]), random.uniform(0.2, 1.0, (1, JOINTS, 3)))
    tracking, step_s, values = Tracking(JOINTS), 1e-4, []
    offset = random.uniform(-0.5, 0.5, JOINTS)
    final = np.full(JOINTS, 0.01)
    near, far = 1.2 * np.abs(offset) + 0.05, 0.4 * np.abs(offset) + 0.03
    above = offset >= 0.0
    funnel = Funnel(np.where(above, near, far), np.where(above, far, near), final, 4.0)

    def rate(time_s, state):
        tracking.position[:], tracking.velocity[:] = state[:JOINTS], state[JOINTS:]
        tracking.update(time_s, step_s, reference, funnel)
        torque = law.torque(tracking)
        acceleration = forward_dynamics(model, state[:JOINTS], state[JOINTS:], torque)
        return np.concatenate([state[JOINTS:], acceleration])

    start = np.zeros((3, JOINTS))
    reference.evaluate(0.0, *start)
    state = np.concatenate([start[0] + offset, random.uniform(-0.5, 0.5, JOINTS)])
    for index, now in enumerate(runge_kutta(rate, state, step_s, 4000)):
        rate(index * step_s, now)
        sliding = law.diagnostics.sliding_variable
        values.append(0.5 * sliding @ model.mass_matrix(now[:JOINTS]) @ sliding)
    assert values[0] > 0.1
    # RK4 is exact to 1e-9 here, but for the root of s near zero, where V is 1e-9 of its start.
    assert np.diff(values).max() < 1e-8 * values[0]
    assert values[-1] < 1e-6 * values[0]


def test_the_adaptive_law_is_the_network_beside_the_model():
    order, model = (0, 1, 2), DecoupledModel((0, 1, 2))
    gains, neural = gains_of("fixed_time_neural"), law_of("fixed_time_neural", order)
    adaptive = LAWS["fixed_time_adaptive"].build(gains, model, NO_LIMITS)
    none = np.zeros(JOINTS)
    shared = {
        name: getattr(gains, name) for name in ("alpha_1", "alpha_2", "phi_1", "phi_2", "eta")
    }
    bare = gains_of("fixed_time_model_based")._replace(k_1=none, k_2=none, k_3=none, **shared)
    feedforward = LAWS["fixed_time_model_based"].build(bare, model, NO_LIMITS)
    for tick in range(50):
        errors = 0.05 * np.sin(0.1 * tick + np.arange(3))
        now = situation(errors, np.zeros(3), time_s=1e-3 * tick)
        expected = neural.torque(now) + feedforward.torque(now)
        np.testing.assert_array_equal(adaptive.torque(now), expected)
