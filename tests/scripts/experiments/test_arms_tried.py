"""The table of arm files that were tried."""

import time

import pytest

from deploy.scenario.referenced_files import ROBOTS
from scripts.experiments.arms_tried import RUNS, files_of, opened, page, table, time_limit, tried

XACRO = """<robot xmlns:xacro="http://www.ros.org/wiki/xacro" name="a">
<xacro:if value="${{'$(arg kind)' == 'long'}}"/>
{0}</robot>"""
JOINT = """<link name="world"/><link name="tip"><inertial><mass value="2"/>
<origin xyz="0.5 0 0"/><inertia ixx="0.1" iyy="0.1" izz="0.1" ixy="0" ixz="0" iyz="0"/></inertial>
</link><joint name="turn" type="revolute"><parent link="world"/><child link="tip"/>
<axis xyz="0 1 0"/><limit lower="-2" upper="2" effort="20" velocity="2"/></joint>"""
KEPT = {"joints": 6, "mass_kg": 9.0, "estimated": ["rotor inertia"], "load": 0.4, "warnings": []}


@pytest.fixture
def folder(tmp_path):
    (tmp_path / "07-vendor").mkdir()
    for name, text in {
        "arm.xacro": XACRO.format(JOINT),
        "paint.xacro": '<robot name="paint"/>',
        "arm_macro.xacro": JOINT,
        "broken.urdf": "<robot",
        "notes.txt": "",
    }.items():
        (tmp_path / "07-vendor" / name).write_text(text)
    return tmp_path


def test_files_of_arms_are_found_and_macros_are_not(folder):
    names = [path.name for path in files_of(folder)]
    assert names == ["arm.xacro", "broken.urdf", "paint.xacro"]


def test_missing_arguments_get_the_first_value_of_the_message(folder):
    arm, words = opened(folder / "07-vendor/arm.xacro")
    assert words == ["kind:=long"]
    assert arm.joint_names == ("turn",)


def test_a_file_has_its_facts_and_verdicts(folder, monkeypatch):
    monkeypatch.setattr("scripts.experiments.arms_tried.verdict", lambda *_: "kept")
    row = tried(folder / "07-vendor/arm.xacro", folder)
    assert row["command"] == "funnel-hil robot arm.xacro kind:=long"
    # 2 kg at 0.5 m: 9.81 of 20 N m.
    assert (row["joints"], row["mass_kg"], row["load"]) == (1, 2.0, pytest.approx(0.49, abs=0.002))
    assert row["estimated"] == ["rotor inertia", "dry friction", "viscous friction"]
    assert [row[name] for name in RUNS] == [["kept"] * 3] * 3
    assert row["difference"] < 1e-12  # from pinocchio's own reading
    broken = tried(folder / "07-vendor/broken.urdf", folder)
    assert not broken["opens"]
    assert str(folder) not in broken["reason"]


def test_the_page_has_rates_and_names_goals_that_are_missed(folder):
    part = tried(folder / "07-vendor/paint.xacro", folder)
    first = {
        "vendor": "07-vendor",
        "file": "a.urdf",
        "command": "funnel-hil robot a",
        "opens": True,
    }
    kept, lost, some = ["kept"] * 3, ["lost"] * 3, ["kept", "lost", "kept"]
    rows = [
        part,
        {**first, **KEPT, "difference": 2e-9, "no delay": kept, "16 ms": some, "48 ms": lost},
        {**first, **KEPT, "load": 3.0, "no delay": lost, "16 ms": lost, "48 ms": lost},
        {**first, "opens": False, "reason": "a | b"},
    ]
    text = page(rows, "Conditions.", "arms.csv")
    assert "| open | 3 | 67 % | 67 % | 67 % | 95 %, **missed** |" in text
    # The weak arm does not count.
    strong = "arms that have the torque | 1"
    assert f"| kept, no delay, {strong} | 100 % | 100 % | 100 % | 98 % |" in text
    assert f"| kept, 16 ms, {strong} | 100 % | 0 % | 100 % | – |" in text
    assert f"| kept, 48 ms, {strong} | 0 % | 0 % | 0 % | 93 %, **missed** |" in text
    assert "| kept, no delay, all that open | 2 | 50 % | 50 % | 50 % | 98 %, **missed** |" in text
    assert "of 1 files differ by at most 2e-09" in text
    assert "<arms.csv>" in text
    head, strong_arm, _, broken = table(rows)  # and not the part, which has no joint
    assert strong_arm[:6] == ["vendor", "funnel-hil robot a", 6, "9", "rotor inertia", "0.4"]
    assert strong_arm[6:] == ["", "kept", "kept, lost, kept", "lost"]
    assert "does not open: a | b" in broken
    assert len(head) == len(strong_arm) == len(broken)


def test_a_file_that_takes_too_long_is_given_up():
    with pytest.raises(TimeoutError, match="within 1 s"), time_limit(1):
        time.sleep(60.0)


def test_shipped_arms_open_without_arguments():
    assert opened(ROBOTS / "paper_arm.urdf")[1] == []
