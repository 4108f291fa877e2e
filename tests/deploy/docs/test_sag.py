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
    for kind, name in (("xml", "one_link.urdf"), ("yaml", "one_link_sag.yaml")):
        text = block(PAGE, kind, name.partition(".")[0])
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
