"""Angles in degrees and lengths in mm are those in rad and m, wherever a scenario has them."""

from __future__ import annotations

import math

import numpy as np
import pytest

from deploy.scenario.base_units import in_base_units
from deploy.scenario.scenario import load_setup
from deploy.scenario.yaml_files import ScenarioError


@pytest.mark.parametrize(
    ("key", "given", "expected"),
    [
        ("angle_rad", "180deg", math.pi),
        ("angle_rad", "-0.5 deg", -math.pi / 360),
        ("angle_rad", "2mrad", 0.002),
        ("final_rad", ["90deg", 1, "1e1deg"], [math.pi / 2, 1, math.pi / 18]),
        ("speed_rad_s", "360deg/s", 2 * math.pi),
        ("limit_rad_s2", "90deg/s2", math.pi / 2),
        ("length_m", "5mm", 0.005),
        ("speed_m_s", "5cm/s", 0.05),
        ("angle_rad", "180 degrees", math.pi),
        ("angle_rad", "180°", math.pi),
        ("speed_rad_s", "180°/s", math.pi),
        ("length_m", "5 millimetres", 0.005),
        ("loss", "5%", 0.05),
        ("coulomb_share", ["3 %", 0.5], [0.03, 0.5]),
    ],
)
def test_values_with_units_are_those_of_their_key(key, given, expected):
    found = in_base_units({"a": [{key: given}]})["a"][0][key]
    assert found == pytest.approx(expected, rel=1e-15)


@pytest.mark.parametrize(
    ("key", "given"),
    [("a_rad", "5%"), ("name", "5%"), ("a_rad", "2mm"), ("a_m", "2deg"),
     ("stiffness_nm_rad", "2deg"), ("law", "2deg"), ("a_rad", "1e3"),
     ("a_rad", "deg"), ("a_rad_s", "2deg")],
)  # fmt: skip
def test_other_texts_stay_as_they_are(key, given):
    assert in_base_units({key: given}) == {key: given}


def test_scenario_in_degrees_is_the_scenario_in_rad():
    keys = "robot.initial_offset_rad", "funnel.final_rad"
    degrees = [0.5, 0.4]
    one = load_setup("paper_arm", [f"{k}={v}deg" for k, v in zip(keys, degrees, strict=True)])
    other = load_setup(
        "paper_arm", [f"{k}={math.radians(v)!r}" for k, v in zip(keys, degrees, strict=True)]
    )
    np.testing.assert_allclose(one.start_position_rad, other.start_position_rad, rtol=1e-14)
    np.testing.assert_allclose(one.funnel.final_rad, other.funnel.final_rad, rtol=1e-14)


def test_percent_is_the_share_to_the_bit():
    shares = [in_base_units({"loss": f"{percent}%"})["loss"] for percent in range(101)]
    assert shares == [percent / 100 for percent in range(101)]
    assert load_setup("paper_arm", ["link.uplink.loss=35%"]).link.uplink.loss == 0.35


def test_a_share_above_one_names_percent():
    hint = r"link\.uplink\.loss = 5: must be .* 1; 5 % is written 0\.05 or 5%"
    with pytest.raises(ScenarioError, match=hint):
        load_setup("paper_arm", ["link.uplink.loss=5"])
    with pytest.raises(ScenarioError, match=r"'5 percent': must be .*; write 5%"):
        load_setup("paper_arm", ["link.uplink.loss=5 percent"])


def test_held_joints_are_angles_or_lengths():
    found = in_base_units({"robot": {"hold": {"lift": "200mm", "head": "90deg"}}})
    assert found["robot"]["hold"] == {"lift": 0.2, "head": pytest.approx(math.pi / 2, rel=1e-15)}


def test_unit_that_does_not_fit_is_refused_with_its_key():
    with pytest.raises(ScenarioError, match=r"initial_offset_rad.*'2mm'"):
        load_setup("paper_arm", ["robot.initial_offset_rad=2mm"])


@pytest.mark.parametrize(
    ("given", "hint"),
    [
        ("robot.initial_offset_deg=3", "robot.initial_offset_deg: unknown key; write"
         " initial_offset_rad: 3deg"),
        ("robot.initial_offset_degrees=[3, 2.5, 1]",
         "write initial_offset_rad: [3deg, 2.5deg, 1deg]"),
        ("funnel.final_deg=0.5deg", "write final_rad: 0.5deg"),
        ("reference.x.offset_mm=5", "write offset_m: 5mm"),
        ("limits.velocity_deg_s=10", "write velocity_rad_s: 10deg/s"),
        ("rate_khz=1", "unknown key; did you mean rate_hz?"),
        ("robot.initial_offset_rad=3 grad", "write 3deg or 3mrad or 3rad"),
        ("robot.initial_offset_rad=[3 grad, 1, 1]", "write 3deg or 3mrad or 3rad"),
        ("reference.x.offset_m=-5 in", "write -5mm or -5cm or -5m"),
        ("link.uplink.delay_ms=10 milliseconds", "write the number alone, in ms"),
        ("plant.payload_kg=20 g", "write the number alone, in kg"),
        ("duration_s=abc", "as a number"),
        *[(f"robot.initial_offset_deg={given}", "unknown key; did you mean initial_offset_rad?")
          for given in ('"3\\nbounds kept"', "true", ".nan", ".inf", "null", "[]", "[1, abc]",
                        "[[1, 2]]", "3mm", "1e999deg")],
        ("robot.initial_offset_deg=[0.5 deg, 3]", "write initial_offset_rad: [0.5deg, 3deg]"),
        *[(f"robot.initial_offset_rad={given}", "or a list of numbers with one per joint")
          for given in ("1.2.3 foo", ". foo", "1e999 foo", "nan deg", "1-2 foo")],
        (f"robot.initial_offset_deg=[{', '.join(['1'] * 3000)}]",
         f"write initial_offset_rad: [{'1deg, ' * 19}1d..."),
    ],
)  # fmt: skip
def test_keys_and_values_in_other_units_are_refused_with_the_spelling_that_is_taken(given, hint):
    with pytest.raises(ScenarioError) as refused:
        load_setup("paper_arm", [given])
    assert str(refused.value).endswith(hint)
