"""Runs over CAN in which drives close loops of their own in their protocols' position modes."""

from __future__ import annotations

import numpy as np
import pytest

from bus_schema.messages.topics import PLANT_TRUTH
from deploy.judge.metrics import summarise
from deploy.judge.run_data import RunData
from deploy.run.simulate import simulate
from deploy.scenario.scenario import load_setup

FEEDBACK = "controller.drive_feedback.enabled=true"
GIVEN = (FEEDBACK, "link.can.interface=virtual", "link.can.answer_timeout_s=60")
PROTOCOLS = {
    "cia402": (),
    "cansimple": ("link.can.protocol=cansimple", "link.can.cansimple.input_torque_scale=40"),
}


def run(*overrides: str) -> RunData:
    return simulate(load_setup("paper_arm_can", [*GIVEN, *overrides])).data()


@pytest.mark.parametrize("protocol", PROTOCOLS)
def test_bounds_are_kept_as_with_drives_that_are_no_can_nodes(protocol: str) -> None:
    """The same laws, gains and targets without CAN between them: what differs is rounding."""
    setup = load_setup("paper_arm_can", [FEEDBACK, "duration_s=0.6", "link.kind=in_process"])
    without, over_can = (
        summarise(each)
        for each in (simulate(setup).data(), run("duration_s=0.6", *PROTOCOLS[protocol]))
    )
    assert over_can["completed"]
    assert over_can["faults"] == []
    assert over_can["bounds"]["kept"]
    assert over_can["bounds"]["margin_min"] == pytest.approx(
        without["bounds"]["margin_min"], abs=0.01
    )


def test_torques_without_targets_keep_bounds_too() -> None:
    """The drives could take targets, and the controller sends none."""
    data = run("duration_s=0.4", "controller.drive_feedback.enabled=false",
               "plant.drive_feedback.enabled=true")  # fmt: skip
    assert summarise(data)["bounds"]["kept"]
    assert data.faults() == []


@pytest.mark.parametrize("protocol", PROTOCOLS)
def test_targets_that_stop_coming_end_in_the_drives_own_timeout(protocol: str) -> None:
    data = run("duration_s=2", *PROTOCOLS[protocol], "link.can.faults.bus_off_s=0.3")
    assert not summarise(data)["completed"]
    assert np.abs(data.tables[PLANT_TRUTH.name]["velocity"][-1]).max() < 0.02
