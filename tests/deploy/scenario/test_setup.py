"""What a scenario makes of its controller's compensation and of its drives."""

from __future__ import annotations

import numpy as np
import pytest

from deploy.run.network.real_delay import knowing_real_delay
from deploy.scenario.scenario import load_setup

ON = "controller.delay_compensation.enabled=true"
EXPECTED = "controller.delay_compensation.expected_round_trip_ms"
DRIVES = "controller.drive_feedback.enabled=true"
DELAYS = ("link.uplink.delay_ms=10", "link.downlink.delay_ms=5")


def setup_of(*overrides):
    return load_setup("paper_arm", overrides)


def first_horizon_ms(setup):
    return setup.control_task().compensation.horizon_ns * 1e-6


@pytest.mark.parametrize(
    ("overrides", "expected_ms"),
    [
        ((), 0.0), (DELAYS, 15.0), ((*DELAYS, f"{EXPECTED}=40"), 40.0),
        ((*DELAYS, f"{EXPECTED}=0"), 0.0), ((*DELAYS, "link.playout_ms=24"), 24.0),
        ((f"{EXPECTED}=0.25",), 0.25),
    ],
)  # fmt: skip
def test_first_horizon_is_what_is_expected_of_the_round_trip(overrides, expected_ms):
    assert first_horizon_ms(setup_of(ON, *overrides)) == expected_ms


def test_a_real_delay_adds_to_what_is_expected_unless_the_scenario_says():
    expected_ms = 15.0 + 30.0 + 1.0  # emulated, of the relay, a tick for the bus and its processes
    assert first_horizon_ms(knowing_real_delay(setup_of(ON, *DELAYS), 30.0)) == expected_ms
    text = setup_of(ON, *DELAYS, f"{EXPECTED}=7")
    assert first_horizon_ms(knowing_real_delay(text, 30.0)) == 7.0


def test_drives_add_nothing_by_default():
    setup = setup_of(ON)
    assert not setup.drive.is_active
    assert not setup.plant_task(lockstep=True).takes_targets
    assert not setup.control_task().sends_targets


def test_drives_are_critically_damped_for_the_inertia_they_govern():
    setup = setup_of(DRIVES, "controller.drive_feedback.bandwidth_rad_s=50")
    inertia = setup.governing_inertia_kg_m2
    np.testing.assert_allclose(setup.drive.stiffness_nm_rad, 2500.0 * inertia, rtol=1e-12)
    np.testing.assert_allclose(setup.drive.damping_nm_s, 100.0 * inertia, rtol=1e-12)
    assert setup.plant_task(lockstep=True).takes_targets
    assert setup.control_task().sends_targets


def test_gains_of_the_drives_can_be_given():
    setup = setup_of(DRIVES, "plant.drive_feedback.stiffness_nm_rad=[900, 800, 70]")
    assert setup.drive.stiffness_nm_rad.tolist() == [900.0, 800.0, 70.0]
    np.testing.assert_allclose(
        setup.drive.damping_nm_s, 200.0 * setup.governing_inertia_kg_m2, rtol=1e-12
    )
    setup = setup_of(DRIVES, "plant.drive_feedback.damping_nm_s=4")
    assert setup.drive.damping_nm_s.tolist() == [4.0, 4.0, 4.0]


def test_drives_of_a_plant_take_targets_that_this_controller_does_not_send():
    setup = setup_of("plant.drive_feedback.enabled=true")
    assert setup.drive.is_active
    assert setup.plant_task(lockstep=True).takes_targets
    assert not setup.control_task().sends_targets
