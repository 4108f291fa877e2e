"""Why a run left its funnel."""

from dataclasses import replace

import numpy as np
import pytest

from deploy.judge.findings.loss_reason import loss_reason
from deploy.judge.metrics import summarise
from deploy.run.simulate import simulate
from deploy.scenario.scenario import load_setup

ON = "controller.delay_compensation.enabled=true"


def loss(*overrides, arm="paper_arm", duration_s=0.5):
    setup = load_setup(arm, [f"duration_s={duration_s}", *overrides])
    return summarise(simulate(setup).data())["loss"]


@pytest.mark.parametrize(
    ("overrides", "reason"),
    [
        ((), None),
        # The arm may be held for 122.7 ms.
        ((ON, "link.uplink.delay_ms=140"), "start"),
        (("link.uplink.delay_ms=8", "controller.law=fixed_time_neural"), "growing"),
        # No command arrives from 0.1 s to 0.3 s: the arm goes on with the last torque.
        (("link.downlink.schedule=[{kind: outage, at_s: 0.1, for_s: 0.2}]",), "late command"),
        (("plant.actuator.saturation_nm=[30, 60, 20]",), "saturated"),
        (("plant.friction.coulomb_nm=150", "controller.law=pid"), "friction or model"),
    ],
)
def test_a_loss_has_a_reason(overrides, reason):
    found = loss(*overrides)
    assert (found and found["reason"]) == reason


@pytest.mark.parametrize("error", [np.nan, np.inf])
def test_positions_that_are_no_numbers_are_a_loss_with_a_reason(error):
    setup = load_setup("paper_arm", ["duration_s=0.5", "link.uplink.delay_ms=8"])
    data = simulate(setup).data()
    truth = data.tables["plant_truth"].copy()
    truth["position"][100:] = error
    found = loss_reason(replace(data, tables={**data.tables, "plant_truth": truth}))
    assert found == ("friction or model", "base_yaw", pytest.approx(0.1), None, None)


def test_the_frequency_is_that_of_the_oscillation():
    """A loop with a delay of 8 ms oscillates with some four delays as its period."""
    found = loss("link.uplink.delay_ms=8", "controller.law=fixed_time_neural")
    assert 20.0 < found["frequency_hz"] < 40.0
    assert found["joint"] == "elbow"
