"""The sag of a mounted arm is the one that the page on OpenArm lists."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

from bus_schema.messages import topics
from deploy.run.simulate import simulate
from deploy.scenario.scenario import load_setup
from tests.deploy.docs.pages import DOCS, block

PAGE = "how-to/openarm.md"
TARGETS_DEG = (30, 45, 60, 75, 90)
ONE_LINK = {
    "one_link.urdf": """\
<robot name="one_link">
  <link name="base"/>
  <joint name="joint1" type="revolute">
    <parent link="base"/>
    <child link="link1"/>
    <axis xyz="0 0 1"/>
    <limit lower="-3" upper="3" effort="40" velocity="10"/>
  </joint>
  <link name="link1">
    <inertial>
      <origin xyz="0 -0.6 0"/>
      <mass value="2.3445"/>
      <inertia ixx="0.01" iyy="0.01" izz="0.01" ixy="0" ixz="0" iyz="0"/>
    </inertial>
  </link>
</robot>
""",
    "one_link_sag.yaml": """\
name: one_link_sag
duration_s: 25
robot:
  urdf: one_link.urdf
  base_rpy_rad: [1.5707963, 0, 0]     # the axis of joint 1 is horizontal
reference:
  kind: minimum_jerk
  waypoints:
    - {time_s: 0, position_rad: 0}
    - {time_s: 1, position_rad: 0.523599}
    - {time_s: 5, position_rad: 0.523599}
    - {time_s: 6, position_rad: 0.785398}
    - {time_s: 10, position_rad: 0.785398}
    - {time_s: 11, position_rad: 1.047198}
    - {time_s: 15, position_rad: 1.047198}
    - {time_s: 16, position_rad: 1.308997}
    - {time_s: 20, position_rad: 1.308997}
    - {time_s: 21, position_rad: 1.570796}
controller:
  law: pid
  gains:
    pid: {proportional: 20, integral: 0, derivative: 5}
""",
}
"""Files of an arm of one link without friction: m g l = 13.8 N m, K_p = 20 N m/rad."""


def listed(row: str) -> list[float]:
    """The angles of a row of the page's table, degrees."""
    (line,) = (line for line in (DOCS / PAGE).read_text().splitlines() if f"| {row}" in line)
    return [float(each) for each in re.findall(r"([0-9.]+)°", line)]


def reached_deg(scenario: Path, times_s: list[float], *overrides: str) -> list[float]:
    """Angles of joint 1 at these times."""
    setup = load_setup(str(scenario), overrides)
    positions = np.array(simulate(setup).data().tables[topics.PLANT_TRUTH.name]["position"])
    rows = np.round(np.array(times_s) * setup.scenario.rate_hz).astype(int) - 1
    return np.degrees(positions[rows, 0]).tolist()


def test_one_link_arm_sags_as_listed(tmp_path: Path) -> None:
    for name, text in ONE_LINK.items():
        (tmp_path / name).write_text(text)
    found = reached_deg(tmp_path / "one_link_sag.yaml", [5, 10, 15, 20, 25])
    assert found == pytest.approx([17.9, 27.0, 36.5, 46.4, 56.9], abs=0.05)
    assert listed("one link") == pytest.approx(found, abs=0.05)
    loads = 13.8 * np.sin(np.radians(found)) / 20.0
    np.testing.assert_allclose(np.radians(TARGETS_DEG) - np.radians(found), loads, atol=2e-3)


@pytest.mark.parametrize(("target_deg", "place"), [(30, 0), (90, 4)])
def test_openarm_sags_as_listed(tmp_path: Path, target_deg: int, place: int) -> None:
    scenario = tmp_path / "openarm_sag.yaml"
    text = block(PAGE, "yaml", "name: openarm_sag")
    scenario.write_text(text.replace("[1.5707963, -1", f"[{np.radians(target_deg)}, -1"))
    (found,) = reached_deg(scenario, [5.0], "link.can.interface=virtual")
    assert listed("`openarm_sag.yaml`")[place] == pytest.approx(found, abs=0.1)
    assert listed("a real OpenArm")[place] == pytest.approx(found, abs=2.0)
