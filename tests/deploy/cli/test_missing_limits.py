"""Every command warns once of what an arm's file leaves open, and keeps it in its results."""

from __future__ import annotations

import json

import pytest

from bus_schema.can.protocol import PROTOCOLS

ARM = """
<robot name="one">
  <link name="base"/>
  <joint name="shoulder" type="revolute">
    <parent link="base"/><child link="upper"/><axis xyz="0 1 0"/>
    <limit lower="-3" upper="3" effort="0" velocity="0"/>
  </joint>
  <link name="upper"><inertial><origin xyz="0.2 0 0"/><mass value="3"/>
    <inertia ixx="0.01" iyy="0.05" izz="0.05" ixy="0" ixz="0" iyz="0"/></inertial></link>
</robot>
"""
SCENARIO = """
name: unlimited
duration_s: 0.1
robot: {urdf: arm.urdf, initial_offset_rad: 0.02}
reference: {kind: joint_sinusoids, centre_rad: 0.1, terms: [{amplitude_rad: 0.1, frequency_rad_s: 2}]}
controller: {law: smc}
metrics: {from_s: 0}
link: {can: {interface: virtual, rated_torque_nm: 10}}
"""  # noqa: E501
SWEEP = "{name: two, scenario: arm.yaml, grid: {controller.model_scale: [1.0, 1.1]}, seeds: 2}"
WARNING = "no effort limit in the URDF for shoulder: torques are UNLIMITED there"
COMMANDS = {
    "simulate": ["simulate", "arm.yaml"],
    "sweep": ["sweep", "sweep.yaml", "--workers", 1],
}  # fmt: skip


@pytest.fixture
def here(tmp_path, monkeypatch):
    for name, text in (("arm.urdf", ARM), ("arm.yaml", SCENARIO), ("sweep.yaml", SWEEP)):
        (tmp_path / name).write_text(text)
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.mark.parametrize("command", COMMANDS)
def test_missing_limit_is_reported_once_and_in_the_results(command, here, funnel_hil):
    output = funnel_hil.output(*COMMANDS[command], "--out", here / "out")
    assert output.count(f"warning: {WARNING}") == 1
    manifest = json.loads((here / "out" / "manifest.json").read_text())
    assert [each for each in manifest["warnings"] if each.startswith(WARNING)]
    for _ in range(2):  # and once it has been reported again
        page = (here / "out" / "report.html").read_text()
        assert page.count(WARNING) == 1
        assert funnel_hil("report", here / "out")[0] == 0


def test_limits_of_the_scenario_take_the_place_of_missing_ones(here, funnel_hil):
    limits = ["--set", "limits.torque_nm=5", "--set", "limits.velocity_rad_s=3"]
    output = funnel_hil.output(*COMMANDS["simulate"], "--out", here / "out", *limits)
    assert "UNLIMITED" not in output


OVER_CAN = [
    "--set",
    "link.kind=can",
    "--set",
    "rate_hz=250",
    "--set",
    "link.can.rated_torque_nm=null",
]


@pytest.mark.parametrize("protocol", [name for name in PROTOCOLS if name != "cia402"])
def test_only_drives_whose_unit_is_a_rated_torque_need_one(protocol, here, funnel_hil):
    fd = ["link.can.fd=true", "link.can.fd_process_data=true"] if protocol == "moteus" else []
    settings = [word for each in (f"link.can.protocol={protocol}", *fd) for word in ("--set", each)]
    words = ["simulate", "arm.yaml", *OVER_CAN, *settings]
    assert f"warning: {WARNING}" in funnel_hil.output(*words, "--out", here / "out")
    summary = json.loads((here / "out" / "summary.json").read_text())
    assert summary["verdict"] in ("kept", "lost")


def test_cia_402_without_effort_limit_and_rated_torque_is_refused(here, funnel_hil):
    output = funnel_hil.output("simulate", "arm.yaml", *OVER_CAN, code=2)
    assert "link.can.rated_torque_nm = null: must be given" in output


def test_drives_say_it_too(here, funnel_hil):
    output = funnel_hil.output("drives", "arm.yaml", "--duration", 0.05)
    assert output.count(f"warning: {WARNING}") == 1
