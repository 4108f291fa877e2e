"""Moments of inertia against mass and size."""

import xml.etree.ElementTree as ET

import numpy as np
import pytest

from bus_schema.urdf.checks import inertia_of
from controller.manipulator_model import ManipulatorModel
from tests.bus_schema.urdf_texts import joint

SHAPE = '<visual><geometry><box size="0.06 0.08 0.1"/></geometry></visual>'


def arm(moment, kg="0.1", shape="", count=4):
    """Joints in a row 0.08 m apart, and links of one mass and moment."""
    names = [f"l{i}" for i in range(count + 1)]
    links = "".join(
        f"""<link name="{name}"><inertial><origin xyz="0.04 0 0" rpy="0 0 0.5"/><mass value="{kg}"/>
        <inertia ixx="{moment}" iyy="{moment}" izz="{moment}" ixy="0" ixz="0" iyz="0"/></inertial>
        {shape}</link>"""
        for name in names[1:]
    )
    joints = "".join(
        joint(f"j{i}", *names[i : i + 2]).replace("0.3 0 0", "0.08 0 0") for i in range(count)
    )
    return f'<robot name="r"><link name="l0"/>{links}{joints}</robot>'


def named(robot):
    return [each for each in robot.warnings if "radius of gyration" in each]


def test_impossible_moments_are_those_of_the_shape_at_the_given_mass(load):
    robot = load(arm("1", shape=SHAPE))
    (warning,) = named(robot)
    assert "l1 (3.16 m: 1 kg m² at 0.1 kg)" in warning
    assert "ESTIMATED" in warning
    assert "inertia of 4 links ESTIMATED" in robot.estimated
    # A box: m (b² + c²) / 12 and so on, in the axes of the link.
    link = ET.fromstring(robot.text).findall("link")[1]
    expected = [0.1 * (0.08**2 + 0.1**2) / 12, 0.1 * (0.06**2 + 0.1**2) / 12]
    xx, xy, _, yy, _, _ = inertia_of(link)
    assert (xx, yy, xy) == pytest.approx([*expected, 0.0], rel=1e-5)
    # The mass and its centre stay: gravity is that of points.
    still = np.zeros(4)
    lever = sum(0.1 * (0.08 * i + 0.04) for i in range(4))
    assert ManipulatorModel(robot).gravity(still)[0] == pytest.approx(-9.81 * lever, rel=1e-6)
    assert load(robot.text).text == robot.text


def test_links_without_shapes_are_rods_to_the_next_joint(load):
    robot = load(arm("1"))
    # Rods of 0.1 kg and 0.08 m about their middle, and the lever of 0.04 m.
    last = ManipulatorModel(robot).mass_matrix(np.zeros(4))[2, 2]
    rod = 0.1 * (0.08**2 / 12 + 0.04**2)
    assert last == pytest.approx(2 * rod + 0.1 * (0.12**2 - 0.04**2), rel=0.1)


@pytest.mark.parametrize(("moment", "is_named"), [("0.02", True), ("0.004", False)])
def test_suspicious_moments_are_named_and_mended_on_request(load, moment, is_named):
    """Radii of 0.45 and 0.2 m; the arm is 0.28 m long."""
    robot = load(arm(moment))
    assert bool(named(robot)) is is_named
    assert all("--repair (robot.repair: true)" in each for each in named(robot))
    assert not robot.estimated
    repaired = load(arm(moment), repair=True)
    assert bool(repaired.estimated) is is_named


def test_arm_of_few_joints_shows_no_size(load):
    assert not named(load(arm("1", count=2)))
