"""What is learned of an arm's model, from which motion, and what is not."""

import numpy as np
import pytest
from prediction_bench import (
    INERTIA,
    LIMITS,
    LOADED,
    MODEL,
    ROBOT,
    START,
    Bench,
    compensation_of,
)

from controller.compensation.arm_belief import SMOOTHING_RAD_S, first_belief, nominal_arm
from controller.compensation.model_identification import (
    INERTIA as INERTIA_FACTOR,
)
from controller.compensation.model_identification import (
    LAG,
    PAYLOAD,
    PER_JOINT,
    WINDOW_S,
    identification,
    take_in,
)
from controller.funnel import Funnel
from controller.manipulator_model import ManipulatorModel
from controller.reference import JointSinusoids
from controller.rigid_bodies.dynamics import ROTOR

WIDE = Funnel(np.full(3, 3.0), np.full(3, 3.0), np.full(3, 3.0), 1.0)
EXCITING = JointSinusoids(
    START,
    np.array([[[0.3, 5.0, 0.0], [0.4, 4.0, 0.0], [0.5, 6.0, 0.0]],
              [[0.1, 11.0, 0.0], [0.1, 13.0, 0.0], [0.15, 17.0, 0.0]]]),
)  # fmt: skip
COULOMB, VISCOUS = np.array([8.0, 6.0, 4.0]), np.array([4.0, 6.0, 2.0])
PROPORTIONAL = np.array([1500.0, 1500.0, 150.0])
DAMPING = np.array([300.0, 300.0, 30.0])


def friction(velocity):
    return -COULOMB * np.tanh(velocity / SMOOTHING_RAD_S) - VISCOUS * velocity


def soft_spring(_tick, _measured, seen):
    """Loose enough to move exactly as a wrong model has it."""
    pull = PROPORTIONAL * (seen.reference_position - seen.position)
    pull += DAMPING * (seen.reference_velocity - seen.velocity)
    return np.clip(MODEL.gravity(seen.position) + pull, -LIMITS, LIMITS)


def moved(ticks=3000, delay=8, **options):
    """A bench whose arm was moved about."""
    settings = {"model": True, "friction": True} if "compensation" not in options else {}
    bench = Bench(
        **(settings | {"law": soft_spring, "reference": EXCITING, "funnel": WIDE} | options)
    )
    bench.run(ticks, delay)
    return bench


def split(bench):
    """The estimate: inertia factor, payload, lag, and f, c and b of the joints."""
    estimate = bench.compensation.identification.estimate
    per_joint = estimate[PER_JOINT:].reshape(3, 3)
    return estimate[INERTIA_FACTOR], estimate[PAYLOAD], estimate[LAG], *per_joint


def assert_covariance_is_one(covariance):
    np.testing.assert_array_equal(covariance, covariance.T)
    assert np.linalg.eigvalsh(covariance).min() > 0.0


@pytest.mark.parametrize(
    ("scale", "payload_kg", "lag_ms", "has_friction"),
    [
        (1.0, 0.0, 0.0, False), (0.7, 0.0, 0.0, False), (1.3, 0.0, 0.0, False),
        (1.0, 2.0, 0.0, False), (1.0, 0.0, 2.0, False), (1.0, 0.0, 0.0, True),
        (1.3, 2.0, 2.0, True),
    ],
)  # fmt: skip
def test_what_differs_from_the_nominal_model_is_found_within_three_seconds(
    scale, payload_kg, lag_ms, has_friction
):
    bench = moved(
        plant=ManipulatorModel(ROBOT, scale=scale, payload_kg=payload_kg), lag_s=1e-3 * lag_ms,
        missing=friction if has_friction else None,
    )  # fmt: skip
    inertia, payload, lag_s, _, coulomb, viscous = split(bench)
    assert inertia == pytest.approx(scale - 1.0, abs=0.015)
    assert payload == pytest.approx(payload_kg, abs=0.03)
    assert lag_s == pytest.approx(1e-3 * lag_ms, abs=4e-4)
    # A twentieth of the largest torque that shows friction, 15 N m s × 2 rad/s.
    np.testing.assert_allclose(coulomb, COULOMB * has_friction, atol=1.6)
    np.testing.assert_allclose(viscous, VISCOUS * has_friction, atol=0.8)
    assert_covariance_is_one(bench.compensation.identification.covariance)


def test_rotor_inertia_is_distinguished_from_link_inertia():
    rotors = np.array([2.0, 4.0, 0.5])
    factors = np.array([1.3, 0.8, 1.2])
    bench = moved(
        plant=ManipulatorModel(ROBOT, scale=0.9, rotor_inertia_kg_m2=factors * rotors),
        compensation=compensation_of(model=True, friction=True, rotors=rotors),
    )
    estimate = bench.compensation.identification.estimate
    assert estimate[INERTIA_FACTOR] == pytest.approx(-0.1, abs=0.03)
    np.testing.assert_allclose(1.0 + estimate[PER_JOINT + 9 :], factors, atol=0.08)
    believed = bench.compensation.belief.inertia[:, ROTOR]
    np.testing.assert_allclose(believed, (1.0 + estimate[PER_JOINT + 9 :]) * rotors, rtol=1e-12)


def test_belief_is_the_nominal_arm_changed_by_the_estimate():
    bench = moved(500, plant=ManipulatorModel(ROBOT, scale=1.3, payload_kg=2.0), lag_s=2e-3)
    inertia, payload, lag_s, _, coulomb, viscous = split(bench)
    belief, bare = bench.compensation.belief, MODEL.inertia_table()
    tip = LOADED.inertia_table() - bare
    np.testing.assert_allclose(belief.inertia, (1.0 + inertia) * bare + payload * tip, rtol=1e-12)
    assert belief.lag_s.tolist() == [lag_s]
    np.testing.assert_array_equal(belief.coulomb_nm, coulomb)
    np.testing.assert_array_equal(belief.viscous_nm_s, viscous)


def test_what_is_not_to_be_learned_stays_as_it_is():
    plant = ManipulatorModel(ROBOT, scale=1.3, payload_kg=2.0)
    nothing = moved(300, model=False, friction=False, plant=plant, missing=friction)
    assert not nothing.compensation.identification.is_active
    assert not nothing.compensation.identification.estimate.any()
    np.testing.assert_array_equal(nothing.compensation.belief.inertia, MODEL.inertia_table())
    assert nothing.compensation.belief.disturbance_nm.any()

    inertia, payload, lag_s, bias, coulomb, viscous = split(
        moved(300, model=False, friction=True, plant=plant, missing=friction)
    )
    assert (inertia, payload, lag_s, viscous.any()) == (0.0, 0.0, 0.0, False)
    assert bias.all()
    assert coulomb.any()

    inertia, _, _, bias, coulomb, viscous = split(
        moved(300, model=True, friction=False, plant=plant, missing=friction)
    )
    assert not coulomb.any()
    assert inertia > 0.1
    assert bias.all()
    assert viscous.any()


@pytest.mark.parametrize("delay", [8, 64])
def test_an_entry_at_its_limit_does_not_drive_the_others_away(delay):
    """Driving torques look like negative friction, which is not believed, nor is all that goes with
    it: with friction alone cut off at 0, payload was soon believed to be 3 kg."""
    driving = np.array([25.0, -40.0, 12.0])
    bench = Bench(
        law=soft_spring, reference=EXCITING, funnel=WIDE, model=True, friction=True,
        plant=ManipulatorModel(ROBOT, scale=1.1), missing=lambda _velocity: driving,
    )  # fmt: skip
    for _ in range(10):
        bench.run(100, delay)
        inertia, payload, *_ = split(bench)
        assert -0.25 <= inertia <= 0.45, bench.tick
        assert payload <= 2.0, bench.tick


def test_nothing_is_learned_outside_the_funnel():
    """Bounds of 0.1 mrad, which a spring does not keep; the brakes hold for the first ticks."""
    plant = ManipulatorModel(ROBOT, scale=1.3)
    narrow = Funnel(np.full(3, 1e-4), np.full(3, 1e-4), np.full(3, 1e-4), 1.0)
    bench = moved(500, plant=plant, funnel=narrow)
    assert np.abs(bench.measured.error).max() > 1e-2
    assert not bench.compensation.identification.estimate.any()
    np.testing.assert_array_equal(bench.compensation.belief.inertia, MODEL.inertia_table())
    assert moved(500, plant=plant).compensation.identification.estimate[INERTIA_FACTOR] > 0.2


def test_nothing_is_learned_of_a_joint_whose_actuator_is_at_its_limit():
    """The others teach on: an arm whose wrist is at its limit is not stuck with a wrong model."""
    limits = LIMITS.copy()
    limits[2] = 1e-3
    bench = moved(500, compensation=compensation_of(model=True, friction=True, limits=limits))
    *_, bias, coulomb, viscous = split(bench)
    assert (bias[2], coulomb[2], viscous[2]) == (0.0, 0.0, 0.0)
    assert bias[:2].all()


def test_steps_are_learned_from_only_in_windows_without_a_gap():
    """Any tick outside the bounds begins the window anew: none is ever full."""
    bench = Bench(law=soft_spring, reference=EXCITING, funnel=WIDE, model=True, friction=True)
    wild = Funnel(np.full(3, 1e-9), np.full(3, 1e-9), np.full(3, 1e-9), 1.0)
    for _ in range(40):
        bench.funnel = WIDE
        bench.run(round(1e3 * WINDOW_S) - 1, 8)
        bench.funnel = wild
        bench.run(1, 8)
    assert not bench.compensation.identification.estimate.any()


@pytest.mark.parametrize("speed", [1e3, 1e80, 1e150, 1e300])
def test_absurd_velocities_leave_a_covariance_and_a_model_behind(speed):
    bench = moved(200)
    filter_, belief = bench.compensation.identification, bench.compensation.belief
    velocity = bench.measured.velocity.copy()
    for sign in (1.0, -1.0):
        bench.measured.velocity[:] = sign * speed
        bench.answer()
        bench.tick += 1
    bench.measured.velocity[:] = velocity
    bench.run(40, 8)
    assert_covariance_is_one(filter_.covariance)
    assert np.linalg.eigvalsh(filter_.covariance).max() < 1e6
    np.testing.assert_allclose(belief.inertia, MODEL.inertia_table(), rtol=0.1, atol=0.1)
    # No model error, and hardly one is believed: a fortieth of the largest torque here.
    assert np.abs(belief.disturbance_nm).max() < 15.0


def test_what_the_model_explains_is_no_disturbance_any_longer():
    """An observer that is faster has made up for a wrong model; the better one makes no jump."""
    limits = np.full(3, np.inf)
    nominal = nominal_arm(MODEL, LOADED, limits)
    belief, filter_ = (
        first_belief(nominal),
        identification(INERTIA, limits, model=True, friction=True),
    )
    true = ManipulatorModel(ROBOT, scale=1.3, payload_kg=2.0)
    velocity, acceleration = np.array([0.8, -0.6, 1.1]), np.array([5.0, -7.0, 9.0])
    step_s, start = 1e-3, np.array([START, velocity])

    def at(time_s):
        rows = start.copy()
        rows[0] += time_s * velocity
        rows[1] += time_s * acceleration
        return rows

    middle = start[0] + 0.5 * WINDOW_S * velocity
    middle_velocity = velocity + 0.5 * WINDOW_S * acceleration
    torque = true.inverse_dynamics(middle, middle_velocity, acceleration)
    torque -= friction(middle_velocity)

    def foreseen():
        """Acceleration that is believed to follow from the torque."""
        pull = torque + belief.disturbance_nm - belief.viscous_nm_s * middle_velocity
        pull -= belief.coulomb_nm * np.tanh(middle_velocity / SMOOTHING_RAD_S)
        factor, payload_kg = 1.0 + filter_.estimate[INERTIA_FACTOR], filter_.estimate[PAYLOAD]
        shares = (factor - payload_kg, MODEL), (payload_kg, LOADED)
        mass = sum(share * model.mass_matrix(middle) for share, model in shares)
        at_rest = middle, middle_velocity, np.zeros(3)
        load = sum(share * model.inverse_dynamics(*at_rest) for share, model in shares)
        return np.linalg.solve(mass, pull - load)

    nominal_torque = MODEL.inverse_dynamics(middle, middle_velocity, acceleration)
    belief.disturbance_nm[:] = nominal_torque - torque
    np.testing.assert_allclose(foreseen(), acceleration, rtol=1e-12)
    before = belief.disturbance_nm.copy()
    steps = round(WINDOW_S / step_s)
    changed = [
        take_in(
            nominal, filter_, belief, at(k * step_s), at((k + 1) * step_s), np.zeros(3),
            step_s * torque, step_s,
        )
        for k in range(steps)
    ]  # fmt: skip
    assert changed == [False] * (steps - 1) + [True]
    assert filter_.estimate[INERTIA_FACTOR] > 0.1
    assert np.abs(belief.disturbance_nm).sum() < 0.5 * np.abs(before).sum()
    # 1e-3: the middle of the window stands for its mean, and tanh of the mean for the mean of tanh
    np.testing.assert_allclose(foreseen(), acceleration, rtol=1e-3)


def test_reset_repeats_all_that_was_learned_bit_for_bit():
    def motion(compensation=None):
        settings = {"compensation": compensation} if compensation else {}
        bench = moved(400, missing=friction, lag_s=2e-3, **settings)
        learned = bench.compensation.belief
        seen = [position.tobytes() for _, position, _ in bench.predicted.values()]
        return bench, seen + [values.tobytes() for values in learned]

    bench, first = motion()
    bench.compensation.reset()
    assert not bench.compensation.identification.estimate.any()
    np.testing.assert_array_equal(bench.compensation.belief.inertia, MODEL.inertia_table())
    _, second = motion(bench.compensation)
    assert second == first
