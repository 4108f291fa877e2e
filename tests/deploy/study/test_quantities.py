"""What grows in a search for margins: of the link, or any number of the scenario."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from deploy.reports.tables import as_markdown
from deploy.scenario.held_arm import held_arm_ceiling_ms
from deploy.scenario.scenario import load_setup
from deploy.scenario.yaml_files import ScenarioError
from deploy.studies.margin.margin import Margin
from deploy.studies.margin.result import MarginResult
from deploy.studies.margin.tables import margins_by_law
from deploy.studies.margin.texts import margin_text
from deploy.study.quantities import excitation
from deploy.study.settings import CasesDefinition, settings
from tests.deploy.study.studies import Here, conduct, made_up

SETUP = load_setup("paper_arm")


def margin_of(**values):
    given = {"laws": ["smc"], "seeds": 1, "offsets": [1], **values}
    return Margin(given, Path("margin"))


def link_at(study, value):
    setting = study.cases[0].setting
    return load_setup(setting.scenario, setting.at(value)).scenario.link


@pytest.mark.parametrize(
    ("direction", "each_ms"), [("both", (6, 6)), ("uplink", (12, 5)), ("downlink", (3, 12))]
)
def test_a_delay_goes_both_ways_or_one(direction, each_ms):
    own = {"uplink": {"link.downlink.delay_ms": 5}, "downlink": {"link.uplink.delay_ms": 3}}
    own = own.get(direction, {})  # of the other one
    link = link_at(margin_of(direction=direction, set=own), 12.0)
    assert (link.uplink.delay_ms, link.downlink.delay_ms) == each_ms


def test_a_running_loop_meets_its_delay_in_a_ramp():
    study = margin_of(running=[False, True])
    assert [case.setting.tags["running"] for case in study.cases] == [False, True]
    setting = study.cases[1].setting
    link = load_setup(setting.scenario, setting.at(40.0)).scenario.link
    assert link.uplink == link.downlink
    assert link.uplink.delay_ms == 1.0  # 2 ms round trip
    (ramp,) = link.uplink.schedule
    assert (ramp.kind, ramp.at_s, ramp.for_s, ramp.delay_ms) == ("ramp", 1.0, 2.0, 20.0)
    short = load_setup(setting.scenario, setting.at(1.0)).scenario.link.uplink
    assert (short.delay_ms, short.schedule[0].delay_ms) == (0.5, 0.5)
    assert [case.ceilings_ms for case in study.cases] == [[pytest.approx(122.7)], []]


def test_jitter_and_loss_of_a_running_loop_start_from_nothing():
    for quantity, key, value in (("jitter", "jitter_ms", 4.0), ("loss", "loss", 0.1)):
        link = link_at(margin_of(quantity=quantity, running=[True], direction="downlink"), value)
        assert getattr(link.downlink, key) == 0.0
        assert getattr(link.downlink.schedule[0], key) == value
        assert link.uplink.schedule == ()


@pytest.mark.parametrize(
    ("key", "limit", "holds", "found", "text"),
    [
        ("plant.payload_kg", 3, lambda v: v <= 1.3, (1.2, 1.4), "1.2"),
        ("controller.model_scale", 0.5, lambda v: v >= 0.73, (0.8, 0.7), "0.8"),
        ("controller.model_scale", 1.5, lambda v: v <= 1.11, (1.1, 1.2), "1.1"),
        ("controller.model_scale", 0.5, lambda _: True, (0.5, None), "≤ 0.5"),
    ],
)
def test_any_number_has_a_margin_from_its_own_value_on(tmp_path, key, limit, holds, found, text):
    study = margin_of(quantity=key, limit=limit, resolution=0.2 if limit == 3 else 0.1)
    _, folder = conduct(study, tmp_path / "out", Here(lambda run: made_up(
        run, violation_fraction=0.0 if holds(run.columns["value"]) else 0.1)))  # fmt: skip
    summary = study.summary(folder.rows)
    (case,) = summary["cases"]
    assert (case["margin"], case["first_failure"]) == found
    result = MarginResult.model_validate(summary)
    assert margin_text(result.cases[0], result) == f"{text} {result.unit}".rstrip()
    assert case["held_arm_ceiling_ms"] is None
    own = {"plant.payload_kg": 0.0, "controller.model_scale": 0.9}[key]
    assert min(abs(probe["value"] - own) for probe in case["probes"]) == 0.0
    setting = study.cases[0].setting
    assert setting.quantity.unit == ("kg" if key == "plant.payload_kg" else "")
    scenario = load_setup(setting.scenario, setting.at(0.55)).scenario
    section, name = key.split(".")
    assert getattr(getattr(scenario, section), name) == 0.55


def test_settings_stand_side_by_side_with_their_ceilings(tmp_path):
    study = margin_of(compensation=[True], running=[False, True], limit=64)
    _, folder = conduct(study, tmp_path / "out", Here(made_up))
    assert as_markdown(
        margins_by_law(MarginResult.model_validate(study.summary(folder.rows)))
    ).splitlines() == [
        "| law | paper_arm, with compensation | paper_arm, with compensation, running |",
        "| --- | --- | --- |",
        "| `smc` | ≥ 64 ms | ≥ 64 ms |",
        "| held-arm ceiling | 123 ms | – |",
    ]


def test_feedback_at_the_drives_is_set_only_where_it_is_asked_for(monkeypatch):
    given = []
    monkeypatch.setattr(
        "deploy.study.settings.load_setup", lambda _, overrides: given.append(overrides) or SETUP
    )
    for asked in (None, [False, True]):
        list(settings(CasesDefinition(set={}, laws=["smc"], drive_feedback=asked), {}))
    key = "controller.drive_feedback.enabled"
    found = [[text for text in overrides if key in text] for overrides in given]
    assert found == [[], [f"{key}=false"], [f"{key}=true"]]


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"quantity": "plant.nothing"}, ["quantity", "'plant.nothing'", "loss, or the dotted"]),
        ({"quantity": "plant.friction.coulomb_nm"}, ["one number of the scenario"]),
        ({"quantity": "plant.payload_kg"}, ["--limit, or limit in", "must be given for"]),
        ({"quantity": "plant.payload_kg", "limit": 2}, ["--resolution, or", "must be given"]),
        ({"quantity": "plant.payload_kg", "limit": -2, "resolution": 1}, ["payload_kg", "-2"]),
        ({"quantity": "plant.payload_kg", "limit": 0, "resolution": 1}, ["limit", "own 0"]),
        ({"quantity": "plant.payload_kg", "direction": "uplink"}, ["direction", "not a quantity"]),
        ({"quantity": "plant.payload_kg", "running": [True]}, ["running", "not a quantity"]),
        ({"direction": "sideways"}, ["direction", "'sideways'", "'uplink'"]),
        ({"running": [True], "duration_s": 3}, ["duration_s", "above 3 s"]),
        ({"running": [True], "set": {"link.uplink.schedule": [
            {"kind": "outage", "at_s": 1, "for_s": 1}]}}, ["link.uplink.schedule", "running"]),
        ({"duration_s": 8, "set": {"duration_s": 20}}, ["duration_s", "given once"]),
    ],
)  # fmt: skip
def test_impossible_quantities_are_refused_with_the_reason(values, message):
    with pytest.raises(ScenarioError) as refusal:
        margin_of(**values)
    assert str(refusal.value).startswith("margin: ")
    assert [word for word in message if word not in str(refusal.value)] == []


def test_runs_are_as_long_as_the_scenario_says_or_as_is_set():
    assert margin_of().bases[0].scenario.duration_s == 20.0
    assert margin_of(set={"duration_s": 12}).bases[0].scenario.duration_s == 12.0


def held(name, offset_scale=1.0, *overrides):
    offset = (offset_scale * load_setup(name).scenario.robot.initial_offset_rad).tolist()
    start = f"robot.initial_offset_rad={json.dumps(offset)}"
    return load_setup(name, [start, *overrides])


@pytest.mark.parametrize(
    ("name", "scale", "ceiling_ms"),
    [("paper_arm", 1.0, 123), ("paper_arm", 0.0, 175), ("iiwa", 1.0, 66), ("iiwa", 0.0, 41),
     ("panda_pybullet", 1.0, 228)],
)  # fmt: skip
def test_the_ceilings_of_the_shipped_arms(name, scale, ceiling_ms):
    # Found independently, with another simulation of the same scenarios.
    assert held_arm_ceiling_ms(held(name, scale)) == pytest.approx(ceiling_ms, abs=0.5)


def test_a_slower_reference_leaves_more_time_and_one_at_rest_all_of_it():
    assert held_arm_ceiling_ms(held("iiwa", 0.0, "reference.speed=0.5")) > 60
    assert held_arm_ceiling_ms(held("iiwa", 0.0, "reference.speed=1e-6")) is None


def test_an_arm_that_is_as_wide_off_as_its_funnel_at_rest_leaves_when_it_closes():
    # A start of 0.1 rad: the bound (1.2 · 0.1 + 0.05 − 0.01) e^(−4 t) + 0.01 is 0.1 after
    # ln(0.16 / 0.09) / 4 = 143.8 ms, while nothing moves.
    jerk = '{"kind": "minimum_jerk", "waypoints": [{"time_s": 0, "position_rad": 0.5}]}'
    setup = load_setup("paper_arm", [f"reference={jerk}", "robot.initial_offset_rad=0.1"])
    assert held_arm_ceiling_ms(setup) == pytest.approx(143.8, abs=0.11)


def test_what_the_other_direction_has_counts_against_one():
    setup = load_setup("paper_arm", ["link.downlink.delay_ms=20"])
    assert held_arm_ceiling_ms(setup, "both") == pytest.approx(122.7)
    assert held_arm_ceiling_ms(setup, "uplink") == pytest.approx(102.7)
    assert held_arm_ceiling_ms(setup, "downlink") == pytest.approx(122.7)


def test_an_arm_with_motors_has_a_margin_from_the_start_and_one_of_a_running_loop():
    def loops(**values):
        own = margin_of(scenarios=["ur5e_motors"], **values)
        return [case.setting.tags["running"] for case in own.cases]

    assert loops() == [False, True]
    assert loops(running=[True]) == [True]
    assert loops(duration_s=2) == [False]  # too short for a ramp
    assert loops(quantity="plant.payload_kg", limit=3, resolution=1) == [False]


def test_a_running_loop_is_pushed_at_every_joint_unless_its_disturbances_are_off():
    """The arm's largest torques are 400, 700 and 300 N m."""
    (given,) = excitation(load_setup("paper_arm"))
    pushed = load_setup("paper_arm", [given]).scenario.plant.disturbance.terms
    pulses = [term for term in pushed if term.kind == "pulse"]
    assert [pulse.torque_nm for pulse in pulses] == pytest.approx([4.0, -7.0, 3.0])
    assert {(pulse.start_s, pulse.duration_s) for pulse in pulses} == {(3.0, 0.02)}
    assert excitation(load_setup("paper_arm", ["plant.disturbance.enabled=false"])) == ()
