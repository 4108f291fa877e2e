import math
from contextlib import closing

import numpy as np
import pytest

from bus_schema.errors import RobotDescriptionError
from bus_schema.robot_description import load_robot
from controller.manipulator_model import ManipulatorModel
from tests.arms import ARMS, INSTALLED, FreeArm, shipped_arm
from tests.bus_schema.urdf_texts import joint, two_links


def test_paper_arm_is_what_its_file_says():
    robot = shipped_arm("paper_arm")
    assert robot.joint_names == ("base_yaw", "shoulder", "elbow")
    assert robot.joints == 3
    assert robot.effort_limits_nm.tolist() == [400.0, 700.0, 300.0]
    assert robot.velocity_limits_rad_s.tolist() == [6.0, 6.0, 6.0]
    assert robot.lower_rad.tolist() == [-3.1, -3.1, -3.0]
    assert robot.upper_rad.tolist() == [3.1, 1.6, 3.0]
    assert robot.tip_link == "tool"


def test_franka_panda_has_seven_joints_and_its_prismatic_fingers_are_fixed():
    robot = shipped_arm("panda")
    assert robot.joint_names == tuple(f"panda_joint{i}" for i in range(1, 8))
    assert robot.effort_limits_nm.tolist() == [87.0] * 4 + [12.0] * 3
    assert 'type="prismatic"' in robot.path.read_text()
    assert 'type="prismatic"' not in robot.resolved_urdf()


@pytest.mark.parametrize("payload_kg", [0.0, 2.5])
@pytest.mark.parametrize("engine", INSTALLED)
@pytest.mark.parametrize("name", ARMS)
def test_engine_reads_the_arm_that_pinocchio_reads(name, engine, payload_kg):
    robot = shipped_arm(name)
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
    robot = shipped_arm(name)
    position, shift = 0.5 * (robot.lower_rad + robot.upper_rad) + 0.1, 1e-6
    bare, loaded = ManipulatorModel(robot), ManipulatorModel(robot, payload_kg=2.0)
    ahead = np.array([bare.tip_position(position + d) for d in shift * np.eye(robot.joints)])
    behind = np.array([bare.tip_position(position - d) for d in shift * np.eye(robot.joints)])
    jacobian = (ahead - behind) / (2 * shift)
    added = loaded.mass_matrix(position) - bare.mass_matrix(position)
    # ΔM = m JᵀJ and ΔG = m g ∂z/∂q, J by central differences of step 1e-6: good to about 1e-9.
    np.testing.assert_allclose(added, 2.0 * jacobian @ jacobian.T, atol=1e-8)
    weight = loaded.gravity(position) - bare.gravity(position)
    np.testing.assert_allclose(weight, 2.0 * 9.81 * jacobian[:, 2], atol=1e-8)


@pytest.mark.parametrize("engine", INSTALLED)
def test_links_without_inertia_have_no_mass(engine, load):
    robot = load(two_links(second=joint("mount", "b", "c", "fixed"), c=""))
    with closing(FreeArm(robot, engine)) as free:
        inertia = free.mass_matrix(np.zeros(1))
    # The rod alone about its joint: 0.03 + 2 × 0.2²; a tip of 1 kg would add 0.09 and more.
    assert inertia == pytest.approx(0.11, abs=1e-10)
    assert ManipulatorModel(robot).mass_matrix(np.zeros(1)) == pytest.approx(0.11, abs=1e-12)


@pytest.mark.parametrize("engine", INSTALLED)
def test_continuous_joint_turns_without_end(engine, load):
    bare = joint("second", "b", "c", "continuous", inside="")
    robot = load(two_links(joint("first", "a", "b", "continuous"), bare))
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


def test_zero_and_missing_effort_and_velocity_limits_are_no_limits(load):
    zero = '<limit effort="0" velocity="0" lower="-1" upper="0"/>'
    joints = joint("first", "a", "b", inside=zero), joint("second", "b", "c", inside="")
    robot = load(two_links(*joints))
    assert robot.effort_limits_nm.tolist() == [math.inf, math.inf]
    assert robot.velocity_limits_rad_s.tolist() == [math.inf, math.inf]
    assert (robot.lower_rad[0], robot.upper_rad[0]) == (-1.0, 0.0)


@pytest.mark.parametrize(
    "mesh", ["meshes/part.stl", "package://meshes/part.stl", "/somewhere/part.stl"]
)
def test_mesh_files_are_named_by_absolute_path(load, tmp_path, mesh):
    shape = f'<visual><geometry><mesh filename="{mesh}"/></geometry></visual>'
    relative = mesh.removeprefix("package://")
    assert f'filename="{tmp_path / relative}"' in load(two_links(a=shape)).resolved_urdf()


def test_tip_is_the_end_of_the_longest_chain(load):
    aside = '<link name="d"/>' + joint("aside", "a", "d", "fixed")
    chain = joint("first", "a", "c"), joint("second", "c", "b")
    assert load(two_links(*chain, more=aside)).tip_link == "b"


def test_missing_file_and_folder_are_named(tmp_path):
    with pytest.raises(RobotDescriptionError, match=r"nowhere\.urdf does not exist"):
        load_robot(tmp_path / "nowhere.urdf")
    with pytest.raises(RobotDescriptionError, match="cannot be read as URDF"):
        load_robot(tmp_path)


def test_arms_of_the_same_file_share_no_array():
    path = shipped_arm("paper_arm").path
    load_robot(path).effort_limits_nm[:] = 0.0
    assert load_robot(path).effort_limits_nm.tolist() == [400.0, 700.0, 300.0]


def test_an_arm_follows_its_file(tmp_path):
    path = tmp_path / "arm.urdf"
    text = shipped_arm("paper_arm").path.read_text()
    path.write_text(text)
    assert load_robot(path).effort_limits_nm[0] == 400.0
    path.write_text(text.replace('effort="400', 'effort="350'))
    assert load_robot(path).effort_limits_nm[0] == 350.0
