"""Files for ROS 2: the arm for ros2_control, and a package of our message types."""

from __future__ import annotations

import re
import xml.etree.ElementTree as ET

import pytest
import yaml
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from bus_schema.messages.topics import JOINT_COMMANDS, JOINT_STATES, TOPICS
from bus_schema.messages.types import PACKAGE, type_hash
from bus_schema.robot_description import load_robot
from deploy.scenario.scenario import load_setup

DOCUMENTED = {
    "joint_commands_topic", "joint_states_topic", "trigger_joint_command_threshold",
    "sum_wrapped_joint_states",
}  # fmt: skip
"""Parameters of JointStateTopicSystem, version 1.1."""


@pytest.mark.parametrize("scenario", ["paper_arm", "panda"])
def test_urdf_and_controllers_name_the_joints_that_are_on_the_bus(funnel_hil, tmp_path, scenario):
    output = funnel_hil.output("ros2-control", scenario, "--out", tmp_path / "out")
    assert str(tmp_path / "out") in output.replace("\n", "")
    setup = load_setup(scenario)
    names = list(setup.robot.joint_names)
    urdf = tmp_path / "out" / "robot.urdf"
    assert list(load_robot(urdf).joint_names) == names  # as any other URDF
    root = ET.parse(urdf).getroot()
    (system,) = root.findall("ros2_control")
    assert system.get("type") == "system"
    parameters = {each.get("name"): each.text for each in system.findall("hardware/param")}
    assert parameters.keys() <= DOCUMENTED
    assert parameters["joint_commands_topic"] == f"/{JOINT_COMMANDS.name}"
    assert parameters["joint_states_topic"] == f"/{JOINT_STATES.name}"
    assert [joint.get("name") for joint in system.findall("joint")] == names
    for joint in system.findall("joint"):
        assert [each.get("name") for each in joint.findall("command_interface")] == ["effort"]
        assert [each.get("name") for each in joint.findall("state_interface")] == [
            "position", "velocity", "effort",
        ]  # fmt: skip
    controllers = yaml.safe_load((tmp_path / "out" / "controllers.yaml").read_text())
    given = controllers["joint_trajectory_controller"]["ros__parameters"]
    assert given["joints"] == list(given["gains"]) == names
    assert all(gains["p"] > 0 and gains["d"] > 0 for gains in given["gains"].values())
    manager = controllers["controller_manager"]["ros__parameters"]
    assert (manager["update_rate"], manager["use_sim_time"]) == (setup.scenario.rate_hz, True)


@pytest.mark.parametrize("name", ["controllers.yaml", "robot.urdf"])
def test_files_that_were_edited_are_replaced_only_when_asked(funnel_hil, tmp_path, name):
    words = ("ros2-control", "paper_arm", "--out", tmp_path)
    assert funnel_hil(*words)[0] == 0
    assert funnel_hil(*words)[0] == 0  # the same once more
    file = tmp_path / name
    written = file.read_text()
    file.write_text(f"{written}\n")
    output = funnel_hil.output(*words, code=2)
    assert name in output
    assert "--overwrite" in output
    assert file.read_text() == f"{written}\n"
    assert funnel_hil(*words, "--overwrite")[0] == 0
    assert file.read_text() == written


def test_types_of_the_package_have_the_hashes_that_we_speak(funnel_hil, tmp_path):
    """Hashes as a ROS 2 distribution has them: rmw_zenoh's keys name them, and must be equal."""
    output = funnel_hil.output("ros-package", tmp_path)
    package = tmp_path / PACKAGE
    assert str(package) in output.replace("\n", "")
    store = get_typestore(Stores.ROS2_JAZZY)
    for file in sorted((package / "msg").glob("*.msg")):
        store.register(get_types_from_msg(file.read_text(), f"{PACKAGE}/msg/{file.stem}"))
    spoken = {topic.type_name for topic in TOPICS if topic.type_name.startswith(PACKAGE)}
    assert len(spoken) == 4
    for name in spoken:
        assert store.hash_rihs01(name) == type_hash(name)


def test_its_build_files_name_every_message_and_all_they_are_made_of(funnel_hil, tmp_path):
    funnel_hil("ros-package", tmp_path)
    package = tmp_path / PACKAGE
    cmake = (package / "CMakeLists.txt").read_text()
    assert {f"msg/{file.name}" for file in (package / "msg").iterdir()} == {
        *re.findall(r'"(msg/\w+\.msg)"', cmake)
    }
    root = ET.fromstring((package / "package.xml").read_text())
    assert root.findtext("name") == PACKAGE
    depends = {element.text for element in root.iter("depend")}
    used = {
        name
        for file in (package / "msg").iterdir()
        for name in re.findall(r"^(\w+)/\w+ ", file.read_text(), re.MULTILINE)
    }
    assert used == depends
