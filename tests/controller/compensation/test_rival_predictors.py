"""Rivals of the default predictor, against the truth and against their equations by hand."""

import numpy as np
import pytest
from prediction_bench import LIMITS, MODEL, Bench, compensation_of

from controller.compensation.delay_compensation import PREDICTORS
from deploy.scenario.scenario import load_setup
from deploy.scenario.yaml_files import ScenarioError

RIVALS = [name for name in PREDICTORS if name != "adaptive"]
NETWORK = "communication_disturbance_observer"
PUSH_NM = np.array([6.0, -5.0, 3.0])


def bench_of(predictor, bandwidth_rad_s=60.0, **settings):
    compensation = compensation_of(predictor=predictor, bandwidth_rad_s=bandwidth_rad_s)
    return Bench(compensation, **settings)


@pytest.mark.parametrize("predictor", ["smith", "hold_prediction"])
@pytest.mark.parametrize("delay", [8, 48])
def test_a_perfect_model_foresees_the_true_motion(predictor, delay):
    bench = bench_of(predictor)
    bench.run(160 + delay, delay)
    position, velocity = bench.prediction_error(range(delay + 2, 160))
    assert position <= 5e-5  # the arm travels 0.1 rad during 48 ms
    assert velocity <= 5e-3


@pytest.mark.parametrize("predictor", RIVALS)
def test_nothing_is_learned_of_a_load(predictor):
    bench = bench_of(predictor, missing=lambda velocity: PUSH_NM)
    bench.run(100, 8)
    belief = bench.compensation.belief
    np.testing.assert_array_equal(belief.disturbance_nm, 0.0)
    np.testing.assert_array_equal(belief.coulomb_nm, 0.0)


def test_model_of_the_smith_predictor_lags_behind_a_load_by_its_filter():
    """After 0.3 s, the model's velocity is behind by a/ω, so that x̂ lacks h (a/ω + a h/2).

    a = M⁻¹ f is the acceleration by the load, ω = 60 rad/s, h = 8 ms. It is not constant while the
    arm swings, hence 5 %.
    """
    bench = bench_of("smith", missing=lambda velocity: PUSH_NM)
    bench.run(320, 8)
    tick, h = 300, 0.008
    _, foreseen, _ = bench.predicted[tick]
    position = bench.truth[tick][0]
    a = np.linalg.solve(MODEL.mass_matrix(position), PUSH_NM)
    missing = bench.truth[tick + 8][0] - foreseen
    np.testing.assert_allclose(missing, h * (a / 60.0 + 0.5 * a * h), rtol=0.05)


def test_network_observer_follows_its_equations():
    """δ = g/(s + g) (a + g q̇) − g q̇ and its integrals, once more with NumPy."""
    g, slow, step_s = 80.0, 80.0 / 6.0, 1e-3
    bench = bench_of(NETWORK, bandwidth_rad_s=g)
    bench.run(120, 8)
    first = 1  # the first state after a command
    filtered, lasting = g * bench.truth[first - 1][1], np.zeros(3)
    velocity, position = np.zeros(3), np.zeros(3)
    for tick in range(first, 120):
        q, d_q = bench.truth[tick]
        torque = np.clip(bench.sent[tick - 1][0], -LIMITS, LIMITS)
        load = MODEL.inverse_dynamics(q, d_q, np.zeros(3))
        asked = np.linalg.solve(MODEL.mass_matrix(q), torque - load)
        seen = asked + g * bench.truth[tick - 1][1]
        filtered = filtered + (1.0 - np.exp(-g * step_s)) * (seen - filtered)
        delta = filtered - g * d_q
        lasting = lasting + (1.0 - np.exp(-slow * step_s)) * (delta - lasting)
        velocity = velocity + step_s * (delta - lasting - slow * velocity)
        position = position + step_s * (velocity - slow * position)
        _, foreseen, foreseen_rate = bench.predicted[tick]
        np.testing.assert_allclose(foreseen, q + position, atol=1e-9)
        np.testing.assert_allclose(foreseen_rate, d_q + velocity, atol=1e-7)


@pytest.mark.parametrize("predictor", list(PREDICTORS))
@pytest.mark.parametrize("wild_rad_s", [1e30, 1e160])
def test_one_wild_state_does_not_end_the_prediction(predictor, wild_rad_s):
    """0.4 s later, the prediction is as in a run without it, to what an observer still forgets."""
    foreseen = []
    for velocity in (0.0, wild_rad_s):
        bench = bench_of(predictor)
        bench.run(100, 8)
        true, bench.measured.velocity[1] = bench.measured.velocity.copy(), velocity
        bench.answer()
        bench.measured.velocity[:] = true
        bench.fly(1, 8)
        bench.run(400, 8)
        foreseen.append(bench.predicted[500][1] - bench.truth[500][0])
    np.testing.assert_allclose(foreseen[1], foreseen[0], atol=7e-4)
    assert np.abs(foreseen[1]).max() > 1e-4


def inertial_law(sees_prediction):
    """A law with poles at 30 rad/s: 24 ms of delay are more than it stands."""

    def torque(_tick, measured, seen):
        at = seen if sees_prediction else measured
        wanted = at.reference_acceleration - 900.0 * at.error - 60.0 * at.error_rate
        return np.clip(MODEL.inverse_dynamics(at.position, at.velocity, wanted), -LIMITS, LIMITS)

    return torque


def largest_error(predictor, *, sees_prediction):
    """Largest error from 0.4 s on, of a loop with 24 ms of delay."""
    bench = bench_of(predictor, law=inertial_law(sees_prediction))
    bench.run(400, 24)
    errors = []
    for _ in range(100):
        bench.run(1, 24)
        errors.append(np.abs(bench.measured.error).max())
    return max(errors)


def test_a_loop_that_delay_makes_swing_comes_to_rest_with_each_predictor():
    """Without prediction the error still swings by 0.1 rad; the network observer is the slowest."""
    assert largest_error(RIVALS[0], sees_prediction=False) > 0.05
    limits = {"smith": 1e-3, "hold_prediction": 1e-3, NETWORK: 0.05}
    for predictor in RIVALS:
        assert largest_error(predictor, sees_prediction=True) < limits[predictor], predictor


def test_a_predictor_that_cannot_serve_is_refused():
    enabled = "controller.delay_compensation.enabled=true"
    chosen = f"controller.delay_compensation.predictor={NETWORK}"
    with pytest.raises(ScenarioError, match=r"drive_feedback\.enabled is true"):
        load_setup("paper_arm", [enabled, chosen, "controller.drive_feedback.enabled=true"])
    with pytest.raises(ScenarioError, match=r"one of adaptive, .*; did you mean smith\?"):
        load_setup("paper_arm", ["controller.delay_compensation.predictor=smyth"])
