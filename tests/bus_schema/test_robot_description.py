import math
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest

from bus_schema.errors import RobotDescriptionError
from bus_schema.robot_description import load_robot
from controller.manipulator_model import ManipulatorModel
from deploy.scenario.referenced_files import find_urdf
from tests.arms import ARMS, INSTALLED, FreeArm

ROD = """
    <inertial>
      <origin xyz="0.2 0 0"/><mass value="2"/>
      <inertia ixx="0.02" iyy="0.03" izz="0.04" ixy="0.001" ixz="0.002" iyz="0.003"/>
    </inertial>"""


def arm(name):
    return load_robot(find_urdf(name, Path()))


def joint(name, kind, parent, child, limit=""):
    return f"""
  <joint name="{name}" type="{kind}">
    <parent link="{parent}"/><child link="{child}"/><origin xyz="0.3 0 0"/><axis xyz="0 1 0"/>
    {limit}
  </joint>"""


def two_links(*joints, inertial=ROD):
    links = "".join(f'<link name="{name}">{inertial}</link>' for name in "bc")
    return f'<robot name="test"><link name="a"/>{links}{"".join(joints)}</robot>'


@pytest.fixture
def write(tmp_path):
    def write_text(text):
        path = tmp_path / "arm.urdf"
        path.write_text(text)
        return path

    return write_text


LIMIT = '<limit effort="5" velocity="3" lower="-1" upper="2"/>'
PLAIN = two_links(
    joint("first", "revolute", "a", "b", LIMIT), joint("second", "revolute", "b", "c", LIMIT)
)


def test_paper_arm_is_what_its_file_says():
    robot = arm("paper_arm")
    assert robot.joint_names == ("base_yaw", "shoulder", "elbow")
    assert robot.joints == 3
    assert robot.effort_limits_nm.tolist() == [400.0, 700.0, 300.0]
    assert robot.velocity_limits_rad_s.tolist() == [6.0, 6.0, 6.0]
    assert robot.lower_rad.tolist() == [-3.1, -3.1, -3.0]
    assert robot.upper_rad.tolist() == [3.1, 1.6, 3.0]
    assert robot.tip_link == "tool"


def test_kuka_iiwa_has_seven_joints_of_300_nm():
    robot = arm("iiwa")
    assert robot.joint_names == tuple(f"lbr_iiwa_joint_{i}" for i in range(1, 8))
    assert robot.effort_limits_nm.tolist() == [300.0] * 7
    assert robot.tip_link == "lbr_iiwa_link_7"


def test_franka_panda_has_seven_joints_and_its_prismatic_fingers_are_fixed():
    robot = arm("panda")
    assert robot.joint_names == tuple(f"panda_joint{i}" for i in range(1, 8))
    assert robot.effort_limits_nm.tolist() == [87.0] * 4 + [12.0] * 3
    assert 'type="prismatic"' in robot.path.read_text()
    assert 'type="prismatic"' not in robot.resolved_urdf()


@pytest.mark.parametrize("payload_kg", [0.0, 2.5])
@pytest.mark.parametrize("engine", INSTALLED)
@pytest.mark.parametrize("name", ARMS)
def test_engine_reads_the_arm_that_pinocchio_reads(name, engine, payload_kg):
    robot = arm(name)
    model = ManipulatorModel(robot, payload_kg=payload_kg)
    random = np.random.default_rng(1)
    with closing(FreeArm(robot, engine, payload_kg=payload_kg)) as free:
        for _ in range(20):
            position = random.uniform(robot.lower_rad, robot.upper_rad)
            expected = model.mass_matrix(position)
            # Rounding alone; a forgotten link, or 1 kg given to a massless one, shows at 1e-3.
            np.testing.assert_allclose(
                free.mass_matrix(position), expected, rtol=0, atol=1e-8 * np.max(expected)
            )


@pytest.mark.parametrize("name", ARMS)
def test_payload_is_a_point_mass_at_the_tip(name):
    robot = arm(name)
    position = 0.5 * (robot.lower_rad + robot.upper_rad) + 0.1
    bare, loaded = ManipulatorModel(robot), ManipulatorModel(robot, payload_kg=2.0)
    shift = 1e-6
    jacobian = np.array(
        [
            (bare.tip_position(position + d) - bare.tip_position(position - d)) / (2 * shift)
            for d in shift * np.eye(robot.joints)
        ]
    )
    added = loaded.mass_matrix(position) - bare.mass_matrix(position)
    # ΔM = m JᵀJ and ΔG = m g ∂z/∂q, J by central differences of step 1e-6: good to about 1e-9.
    np.testing.assert_allclose(added, 2.0 * jacobian @ jacobian.T, atol=1e-8)
    weight = loaded.gravity(position) - bare.gravity(position)
    np.testing.assert_allclose(weight, 2.0 * 9.81 * jacobian[:, 2], atol=1e-8)


@pytest.mark.parametrize("engine", INSTALLED)
def test_links_without_inertia_have_no_mass(engine, write):
    joints = [joint("first", "revolute", "a", "b", LIMIT), joint("mount", "fixed", "b", "c")]
    with_empty_tip = two_links(*joints).replace(f'<link name="c">{ROD}', '<link name="c">')
    robot = load_robot(write(with_empty_tip))
    with closing(FreeArm(robot, engine)) as free:
        inertia = free.mass_matrix(np.zeros(1))
    # The rod alone about its joint: 0.03 + 2 × 0.2²; a tip of 1 kg would add 0.09 and more.
    assert inertia == pytest.approx(0.11, abs=1e-10)
    assert ManipulatorModel(robot).mass_matrix(np.zeros(1)) == pytest.approx(0.11, abs=1e-12)


@pytest.mark.parametrize("engine", INSTALLED)
def test_continuous_joint_turns_without_end(engine, write):
    limit = '<limit effort="5" velocity="3" lower="-1" upper="2"/>'
    text = two_links(
        joint("first", "continuous", "a", "b", limit), joint("second", "continuous", "b", "c")
    )
    robot = load_robot(write(text))
    assert robot.joint_names == ("first", "second")
    assert robot.lower_rad.tolist() == [-math.inf, -math.inf]
    assert robot.upper_rad.tolist() == [math.inf, math.inf]
    assert robot.effort_limits_nm.tolist() == [5.0, math.inf]
    assert robot.velocity_limits_rad_s.tolist() == [3.0, math.inf]
    position = np.array([100.0, -50.0])
    with closing(FreeArm(robot, engine)) as free:
        free.place(position)
        free.push(np.zeros(2))
        # One millisecond of falling is microradians: a joint stop at 2 rad would throw it back.
        np.testing.assert_allclose(free.position, position, atol=1e-3)
        expected = ManipulatorModel(robot).mass_matrix(position)
        np.testing.assert_allclose(free.mass_matrix(position), expected, atol=1e-10)


def test_zero_and_missing_effort_and_velocity_limits_are_no_limits(write):
    zero = '<limit effort="0" velocity="0" lower="-1" upper="0"/>'
    text = two_links(
        joint("first", "revolute", "a", "b", zero), joint("second", "revolute", "b", "c")
    )
    robot = load_robot(write(text))
    assert robot.effort_limits_nm.tolist() == [math.inf, math.inf]
    assert robot.velocity_limits_rad_s.tolist() == [math.inf, math.inf]
    assert (robot.lower_rad[0], robot.upper_rad[0]) == (-1.0, 0.0)


@pytest.mark.parametrize(
    "mesh", ["meshes/part.stl", "package://meshes/part.stl", "/somewhere/part.stl"]
)
def test_mesh_files_are_named_by_absolute_path(write, mesh):
    shape = f'<visual><geometry><mesh filename="{mesh}"/></geometry></visual>'
    path = write(PLAIN.replace('<link name="a"/>', f'<link name="a">{shape}</link>'))
    relative = mesh.removeprefix("package://")
    assert f'filename="{path.parent / relative}"' in load_robot(path).resolved_urdf()


def test_tip_is_the_end_of_the_longest_chain(write):
    text = two_links(
        joint("first", "revolute", "a", "c", LIMIT),
        joint("second", "revolute", "c", "b", LIMIT),
        joint("aside", "fixed", "a", "d"),
    ).replace("</robot>", '<link name="d"/></robot>')
    assert load_robot(write(text)).tip_link == "b"


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("no XML at all", "cannot be read as URDF"),
        ("<robot>", "cannot be read as URDF"),
        ("<sdf/>", "root element is <sdf>"),
        (two_links(joint("first", "fixed", "a", "b")), "no revolute or continuous joint"),
        (PLAIN.replace('effort="5"', 'effort="strong"'), "effort='strong' of joint first"),
        (PLAIN.replace('lower="-1"', 'lower=""'), "lower='' of joint first"),
        (PLAIN.replace('"second"', '"first"'), "unique"),
        (PLAIN.replace('name="second"', ""), "unique and not empty"),
        (PLAIN.replace('<child link="c"/>', ""), "second lacks parent or child"),
    ],
)
def test_unusable_files_are_refused_by_name_with_the_reason(write, text, told):
    path = write(text)
    with pytest.raises(RobotDescriptionError) as caught:
        load_robot(path)
    assert str(path) in str(caught.value)
    assert told in str(caught.value)


@pytest.mark.parametrize("attribute", ["effort", "velocity", "lower", "upper"])
def test_limits_that_are_not_a_number_are_refused(write, attribute):
    # Every comparison with NaN is false: such a limit would hold nothing back.
    text = two_links(joint("first", "revolute", "a", "b", f'<limit {attribute}="nan"/>'))
    with pytest.raises(RobotDescriptionError, match=attribute):
        load_robot(write(text))


def test_missing_file_and_folder_are_told_by_name(tmp_path):
    with pytest.raises(RobotDescriptionError, match=r"nowhere\.urdf does not exist"):
        load_robot(tmp_path / "nowhere.urdf")
    with pytest.raises(RobotDescriptionError, match="cannot be read as URDF"):
        load_robot(tmp_path)
