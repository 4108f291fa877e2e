"""What was identified of the arm: in every cycle's message, and in the summary with the truth."""

import numpy as np
import pytest

from deploy.judge.findings.identified import identified, truth_of
from deploy.judge.metrics import summarise
from deploy.run.simulate import simulate
from deploy.scenario.scenario import load_setup

ON = "controller.delay_compensation.enabled=true"
DELAY = ["link.uplink.delay_ms=5", "link.downlink.delay_ms=5"]
PICKED_UP = "faults=[{kind: payload_picked_up, payload_kg: 1, at_s: 1}]"


def run_of(*overrides):
    return simulate(load_setup("paper_arm", ["duration_s=2", *DELAY, *overrides])).data()


@pytest.fixture(scope="module")
def run():
    return run_of(ON, "plant.actuator.lag_ms=2", "plant.payload_kg=1", PICKED_UP)


def test_every_cycle_reports_the_estimates(run):
    status = run.tables["control_status"]
    for name in ("inertia_factor", "payload_kg", "actuator_lag_s", "learned_viscous"):
        assert np.isfinite(status[name]).all()
    assert status["inertia_factor"][0] == 1.0
    assert not status["payload_kg"][0]
    assert (status["payload_kg"] >= 0.0).all()
    assert (status["actuator_lag_s"] >= 0.0).all()
    assert (status["learned_viscous"] >= 0.0).all()
    assert len(np.unique(status["inertia_factor"])) > 10


def test_payload_is_in_kilograms_for_any_scale_of_the_model():
    quiet = ["plant.friction.enabled=false", "plant.disturbance.enabled=false"]
    for scale in (0.8, 1.0):
        run = run_of(ON, *quiet, f"controller.model_scale={scale}", "plant.payload_kg=2")
        status = run.tables["control_status"][-1]
        assert status["inertia_factor"] == pytest.approx(1.0 / scale, rel=0.02)
        assert status["payload_kg"] == pytest.approx(2.0, rel=0.05)


def test_summary_has_final_values_with_the_truth_beside_them(run):
    found = summarise(run)["identified"]
    status = run.tables["control_status"][-1]
    assert found["inertia_factor"] == status["inertia_factor"]
    assert found["payload_kg"] == status["payload_kg"]
    assert found["lag_ms"] == 1e3 * status["actuator_lag_s"]
    assert found["coulomb_nm"] == status["learned_friction"].tolist()
    assert found["viscous_nm_s"] == status["learned_viscous"].tolist()
    assert found["truth"] == {
        "inertia_factor": 1.0 / 0.9, "payload_kg": 2.0, "lag_ms": 2.0,
        "coulomb_nm": [8.0, 6.0, 4.0], "viscous_nm_s": [10.0, 8.0, 5.0],
    }  # fmt: skip


def test_true_payload_follows_what_is_picked_up(run):
    truth = truth_of(run.setup)
    assert truth["payload_kg"] == [(0.0, 1.0), (1.0, 2.0)]


def test_nothing_identified_is_null_and_what_is_left_out_too():
    assert summarise(run_of("duration_s=0.1"))["identified"] is None
    both = [
        f"controller.delay_compensation.{key}=false" for key in ("identify_model", "learn_friction")
    ]
    assert identified(run_of("duration_s=0.1", ON, *both)) is None
    found = identified(run_of("duration_s=0.1", ON, both[0]))
    assert found["inertia_factor"] is found["payload_kg"] is found["lag_ms"] is None
    assert found["viscous_nm_s"] is None
    assert len(found["coulomb_nm"]) == 3
    found = identified(run_of("duration_s=0.1", ON, both[1]))
    assert found["coulomb_nm"] is None
    assert len(found["viscous_nm_s"]) == 3


def test_without_friction_there_is_none_to_find():
    run = run_of("duration_s=0.1", ON, "plant.friction.enabled=false")
    assert identified(run)["truth"]["coulomb_nm"] == [0.0, 0.0, 0.0]
