"""Who misspells a choice is told what may have been meant."""

from __future__ import annotations

import pytest

RANGE = "{distribution: uniform, from: 0, to: 1}"
MISSPELT = [
    (("margin", "--quantity", "dely"), "delay"),
    (("margin", "--quantity", "link.uplink.delay"), "link.uplink.delay_ms"),
    (("margin", "--quantity", "paylod_kg"), "plant.payload_kg"),
    (("margin", "--direction", "uplnk"), "uplink"),
    (("margin", "--study", "delay_margn"), "delay_margin"),
    (("sweep", "delay_swep"), "delay_sweep"),
    (("simulate", "papr_arm"), "paper_arm"),
    (("simulate", "faults/encoder_stik"), "faults/encoder_stuck"),
    (("simulate", "encoder_stuck"), "faults/encoder_stuck"),
    (("simulate", "--set", "clock=lockstp"), "lockstep"),
    (("simulate", "--set", "link.kind=zenho"), "zenoh"),
    (("simulate", "--set", "link.can.protocol=cia40"), "cia402"),
    (("simulate", "--set", "faults=[{kind: link_ct, at_s: 1}]"), "link_cut"),
    (("simulate", "--set", "robot.urdf=papr_arm"), "paper_arm"),
    (("simulate", "--set", "robot.joints=[elbw]"), "elbow"),
    (("simulate", "--set", f"uncertainty={{plant.paylod_kg: {RANGE}}}"), "plant.payload_kg"),
]


@pytest.mark.parametrize(("words", "meant"), MISSPELT)
def test_a_choice_that_is_misspelt(funnel_hil, nothing_starts, words, meant):
    code, said = funnel_hil(*words)
    assert code == 2
    assert said.endswith(f"; did you mean {meant}?\n")


def test_shipped_faults_are_listed_to_who_asks_for_one(funnel_hil, nothing_starts):
    code, said = funnel_hil("simulate", "faults/nothing_like_it")
    assert code == 2
    assert "faults/actuator_dead, faults/actuator_weak" in said
    assert "paper_arm" not in said
    assert "paper_arm_mit, faults/*" in funnel_hil("simulate", "nowhere")[1]


def test_no_hint_where_nothing_is_alike(funnel_hil, nothing_starts):
    code, said = funnel_hil("margin", "--quantity", "temperature")
    assert code == 2
    assert "did you mean" not in said
    code, said = funnel_hil("margin", "--quantity", "robot.initial_offset_rad")  # one per joint
    assert code == 2
    assert "did you mean" not in said


def test_a_misspelt_joint_is_told_as_what_was_set(funnel_hil, nothing_starts):
    code, said = funnel_hil("simulate", "--set", "robot.joints=[base_yaw,elbw]")
    assert code == 2
    assert said.startswith("error: --set robot.joints=[base_yaw,elbw]: robot.joints = ")
    assert "paper_arm.yaml" not in said
