"""`datasheet`, `margin` and `robot` with ``--interface``: robots that have their own controller."""

import json

import numpy as np
import pytest

from bus_schema.user_files import read_text
from deploy.reports.kinds import gauged
from deploy.scenario.scenario import load_setup
from deploy.scenario.yaml_files import ScenarioError
from deploy.studies.datasheet import robot_page
from deploy.studies.datasheet.command import DatasheetOptions, torque_sheet
from deploy.studies.datasheet.data_sheet import smooth_playout_ms
from deploy.studies.datasheet.result import RobotSheetResult, Way
from deploy.studies.datasheet.robot_sheet import RobotSheet, limiter_key, run_row
from tests.deploy.study.theory.linear_arms import Arm
from tests.warm_process import output_of

SPEED = 0.3
SERVOJ = {
    "plant.interface.servoj.lookahead_time_s": 0.03,
    "plant.interface.servoj.gain": 1200,
}
"""The setting whose lag in all, with a cycle of 2 ms, is 30 ms."""


@pytest.fixture(scope="module")
def ramp(tmp_path_factory):
    """One joint whose reference moves at a constant speed."""
    folder = tmp_path_factory.mktemp("arm")
    lines = (f"{t:.2f},{SPEED * t:.6f}" for t in np.arange(0.0, 7.0, 0.05))
    (folder / "ramp.csv").write_text("\n".join(["time_s,j0.position_rad", *lines]))
    file = Arm([0.5], [1.0], [1.0], [0.0]).write(folder)
    return file, {"reference": {"kind": "csv", "file": str(folder / "ramp.csv")}}


def words_of(values):
    overrides = (f"{key}={json.dumps(value)}" for key, value in values.items())
    return [word for each in overrides for word in ("--set", each)]


@pytest.fixture(scope="module")
def made(ramp, tmp_path_factory):
    """The data sheet of a robot that takes positions, 40 ms away."""
    file, reference = ramp
    out = tmp_path_factory.mktemp("sheet") / "out"
    delays = {"link.uplink.delay_ms": 20, "link.downlink.delay_ms": 20}
    words = (
        "datasheet", file, "--interface", "servoj", "--quick", "--workers", "1",
        *words_of({**reference, **SERVOJ, **delays}), "--out", out,
    )  # fmt: skip
    return out, words, output_of(*words)


def test_a_joint_at_constant_speed_is_behind_by_round_trip_and_lag_unless_it_is_previewed(made):
    """40 ms on the way, 30 in the robot, whose tip is on the axis of its joint."""
    out, _, output = made
    summary = json.loads(read_text(out / "summary.json"))
    ways = {way["way"]: way for way in summary["ways"]}
    without, having = (ways[f"streaming, {word} preview"] for word in ("without", "with"))
    assert without["lag_ms"] == pytest.approx(40.0 + 30.0, rel=0.02)
    assert abs(having["lag_ms"]) < 0.02 * 70.0
    quoted, unknown, sentence = summary["headline"][:3]
    margin_ms = summary["margin"]["cases"][0]["margin"]
    assert quoted.endswith(
        f"over servoj under position_correction: quote a round trip of {margin_ms:g} ms, constant"
        " (trajectory known in advance; --quick: one start, one seed, runs of 3 s)."
    )
    assert unknown == "For a trajectory not known in advance: --set controller.preview_ms=0."
    assert sentence.startswith(
        "streaming over the given link, one run of 3 s each: without preview j0 is"
        f" {without['lag_ms']:.3g} ms behind; with it "
    )
    assert sentence.replace(" ", "") in output.replace("\n", "").replace(" ", "")
    assert "Reflexes: none." in summary["headline"]
    assert summary["conditions"]["effort"] == "--quick: one start, one seed, runs of 3 s"


@pytest.mark.parametrize(
    ("kept", "answer"),
    [
        (0, "bounds are lost in all 5 windows of 3 s of lab.csv, in each of the 4 ways tried"),
        (1, "bounds are kept in 1 of 5 windows of 3 s of lab.csv at best, streaming, with"
         " preview"),
    ],
)  # fmt: skip
def test_a_network_that_is_lost_comes_before_the_margin_of_a_constant_delay(made, kept, answer):
    """And with any lost window, that margin is no number to quote."""
    result = RobotSheetResult.model_validate(json.loads(read_text(made[0] / "summary.json")))
    result.network = "lab.csv"
    for way in result.ways:
        way.runs, way.kept = 5, kept if way.way == "streaming, with preview" else 0
    said = robot_page.headline(result)
    assert said[0] == f"{result.arm} over servoj: {answer} (--quick; more windows: --windows 10)."
    assert not any("quote" in each for each in said)
    margin_ms = result.margin.cases[0].margin
    assert said[1 + kept].startswith(
        "Delays that do not vary are easier: position_correction keeps them up to a round trip of"
        f" {margin_ms:g} ms (trajectory known in advance; --quick"
    )
    assert not any("What often helps" in each for each in said)
    result.smooth_playout_ms = 230.0
    assert robot_page.headline(result)[2 + kept].startswith(
        "What often helps: --set link.playout_ms=230: targets act so long after their states"
    )


def test_the_playout_for_a_network_has_99_percent_of_its_round_trips(tmp_path):
    """Round trips of 2 to 200 ms, as often each: 198 ms, in whole 10 ms."""
    file = tmp_path / "my.csv"
    file.write_text("time_s,delay_ms\n" + "".join(f"{k},{1 + k % 100}\n" for k in range(1000)))
    assert smooth_playout_ms(str(file)) == 200.0
    assert smooth_playout_ms("no_such_network") is None


def test_its_margin_stands_beside_theory(made):
    """k_i = 1/s around a response of unit gain: to about π / 2 s. Before, the arm waits too long.

    Until the first target acts, the error grows by v t: to the bound of 50 mrad at 166.7 ms, of
    which some ms pass in the robot.
    """
    out, _, _ = made
    [case] = json.loads(read_text(out / "summary.json"))["margin"]["cases"]
    assert (case["law"], case["compensation"]) == ("position_correction", None)
    assert 0.05e3 / SPEED - 10.0 < case["margin"] < 0.05e3 / SPEED
    assert case["margin"] < case["theory"]["constant_ms"] < 1e3 * np.pi / 2.0


def test_a_gate_reads_margins_in_ms_and_tip_errors_in_mm(made):
    out, words, _ = made
    summary = json.loads(read_text(out / "summary.json"))
    assert [each.unit for each in gauged(summary)] == ["ms"]
    named = {each.name: each for each in gauged(summary, "mm")}
    assert len(named) == 4
    assert all(each.sign < 0 for each in named.values())
    assert "must be at most 0.001 mm" in output_of(*words, "--at-least", "0.001mm", code=3)


def test_its_report_is_made_again(made):
    out, _, _ = made
    before = read_text(out / "summary.json")
    (out / "report.html").unlink()
    output_of("report", out)
    assert json.loads(read_text(out / "summary.json")) == json.loads(before)
    assert "Ways to drive servoj" in read_text(out / "report.html")


@pytest.fixture
def still(tmp_path):
    """One joint that holds still, and a network that is silent for 25 ms from 1.1 s on."""
    rows = (f"{1e-3 * k:.3f},{'' if 1100 <= k < 1125 else '0.2'}" for k in range(3000))
    (tmp_path / "my.csv").write_text("\n".join(["time_s,delay_ms", *rows]))
    return Arm([0.5], [1.0], [1.0], [0.0]).write(tmp_path / "arm"), str(tmp_path / "my.csv")


def test_twenty_lost_packets_are_a_reflex_with_its_time_and_the_limiter_does_not_help(still):
    """The first of 20 is that of 1.100 s: the robot stops in the cycle of the 20th."""
    file, network = still
    fixed = {"metrics.from_s": 0.5, "controller.delay_compensation.enabled": False}
    sheet = RobotSheet(str(file), "franka_torque", "pid", network, fixed, is_quick=True)
    found = {
        (way.limiter, link): run_row(way, link, setup).reflexes
        for way, link, setup in sheet.runs()
        if link in ("window at 0 s", "no network")
    }
    for limiter in (False, True):
        assert found[limiter, "no network"] == []
        [reflex] = found[limiter, "window at 0 s"]
        assert reflex.kind == "communication_constraints_violation"
        assert reflex.time_s == pytest.approx(1.12, abs=2e-3)


def test_a_limiter_prevents_a_reflex_about_the_rate_of_torques(still):
    """3 N m per mrad on 20 mrad step by more than 1 N m after 15 lost packets."""
    file, _ = still
    fixed = {
        "robot.initial_offset_rad": 0.02, "controller.delay_compensation.enabled": False,
        "controller.gains.pid": {"proportional": 3000, "derivative": 2, "integral": 0},
        "link.downlink.schedule": [{"kind": "outage", "at_s": 0.0105, "for_s": 0.015}],
    }  # fmt: skip
    sheet = RobotSheet(str(file), "franka_torque", "pid", None, fixed, is_quick=True)
    kinds = {way.limiter: run_row(way, link, setup).reflexes for way, link, setup in sheet.runs()}
    assert [each.kind for each in kinds[False]] == ["controller_torque_discontinuity"]
    assert kinds[True] == []


def test_what_is_varied_is_what_applies_to_the_interface():
    def ways(kind, **more):
        return RobotSheet("paper_arm", kind, **more).ways()

    assert [(way.law, way.preview) for way in ways("servoj")] == [
        ("streaming", False), ("streaming", True),
        ("position_correction", False), ("position_correction", True),
    ]  # fmt: skip
    assert ways("speedj")[0] == Way(law="proportional_velocity", preview=False)
    assert {way.limiter for way in ways("franka_position")} == {False, True}
    assert {way.compensation for way in ways("franka_torque")} == {False, True}
    set_already = {"controller.preview_ms": 5}
    assert {way.preview for way in ways("servoj", fixed=set_already)} == {None}


@pytest.mark.parametrize(
    "fixed",
    [{"link.uplink.delay_ms": 0}, {"link.downlink.delay_ms": 0}, {"link.uplink": {"delay_ms": 0}}],
)
def test_a_delay_that_is_set_is_the_given_link_also_if_it_is_0(fixed):
    sheet = RobotSheet("paper_arm", "servoj", fixed=fixed)
    assert sheet.links() == {"the given link": {}}


@pytest.mark.parametrize(
    ("network", "key", "value", "sets"),
    [
        ("wired_lan", "link.uplink.trace.start_s", 1, "link.uplink.trace.start_s"),
        ("wired_lan", "link.downlink", {"delay_ms": 5}, "link.downlink.trace.file"),
        (None, "controller.law", "streaming", "controller.law (--law)"),
        (None, "plant.interface.kind", "speedj", "plant.interface.kind"),
    ],
)
def test_a_value_that_the_sheet_varies_is_refused(network, key, value, sets):
    sheet = RobotSheet("paper_arm", "servoj", None, network, {key: value}, is_quick=True)
    with pytest.raises(ScenarioError) as refused:
        list(sheet.runs())
    assert str(refused.value) == f"--set {key}: must be left out: the data sheet sets {sets}"


def test_the_limiter_of_an_installed_interface_is_among_its_own_settings():
    assert limiter_key("franka_torque") == "plant.interface.franka_torque.limiter"
    assert limiter_key("of_a_package") == "plant.interface.own.limiter"


def test_a_torque_interface_is_that_of_the_data_sheet_of_torques(tmp_path):
    """Also where the scenario's robot takes positions."""
    file = tmp_path / "arm.yaml"
    file.write_text(
        "extends: paper_arm\nplant: {interface: {kind: servoj}}\ncontroller: {law: streaming}\n"
    )
    options = DatasheetOptions(scenario=str(file), law="pid", interface="torque", quick=True)
    kinds = {base.scenario.plant.interface.kind for base in torque_sheet(options).margin().bases}
    assert kinds == {"torque"}


def test_margin_with_an_interface_searches_that_of_its_loop(ramp, tmp_path):
    """P = 10/s on an ideal velocity servo: π / 20 s."""
    file, _ = ramp
    more = {
        "plant.interface.speedj.ideal": True, "plant.interface.rate_hz": 1000,
        "controller.gains.proportional_velocity.k_p": 10, "plant.command_timeout_ms": 1000,
    }  # fmt: skip
    output_of(
        "margin", file, "--interface", "speedj", *words_of(more), "--limit", "200", "--duration",
        "3", "--workers", "1", "--out", tmp_path / "out",
    )  # fmt: skip
    [case] = json.loads(read_text(tmp_path / "out" / "summary.json"))["cases"]
    assert case["law"] == "proportional_velocity"
    assert case["theory"]["constant_ms"] == pytest.approx(1e3 * np.pi / 20.0, abs=1.0)


def test_robot_writes_a_first_scenario_for_an_interface(tmp_path):
    file = tmp_path / "ur.yaml"
    output_of("robot", "ur5e", "--interface", "servoj", "--scenario", "--out", file)
    scenario = load_setup(str(file)).scenario
    assert scenario.plant.interface.kind == "servoj"
    assert scenario.controller.law == "position_correction"


@pytest.mark.parametrize("words", [["datasheet", "paper_arm"], ["margin"], ["robot", "ur5e"]])
def test_an_unknown_interface_is_refused_with_those_that_are_known(words):
    output = " ".join(output_of(*words, "--interface", "servo_j", code=2).split())
    assert "--interface servo_j: must be one of torque, servoj, speedj, franka_position" in output
    assert "did you mean servoj?" in output


def test_plants_are_refused_with_a_robot():
    output = output_of("datasheet", "--interface", "servoj", "--plants", "3", code=2)
    assert "--plants: must be left out with --interface servoj" in output


NO_TORQUE = """
  <ros2_control name="x" type="system"><joint name="j0">
    <command_interface name="position"/><command_interface name="velocity"/>
  </joint></ros2_control></robot>"""


@pytest.mark.parametrize(
    ("old", "new", "why"),
    [
        ("</robot>", NO_TORQUE, "has command interfaces for position, velocity alone"),
        ('effort="', 'effort="0" was="', "gives no largest torque of j0"),
    ],
)
def test_a_torque_interface_of_an_arm_without_torque_is_refused(tmp_path, old, new, why):
    file = Arm([0.5], [1.0], [1.0], [0.0]).write(tmp_path)
    urdf = tmp_path / "arm.urdf"
    urdf.write_text(urdf.read_text().replace(old, new, 1))
    with pytest.raises(ScenarioError) as refused:
        load_setup(str(file), ["plant.interface.kind=franka_torque"])
    message = str(refused.value)
    assert "plant.interface.kind" in message
    assert "'franka_torque': must be of positions or velocities" in message
    assert why in message
    load_setup(str(file), ["plant.interface.kind=servoj", "controller.law=streaming"])
