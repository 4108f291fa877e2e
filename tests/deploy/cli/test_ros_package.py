"""Our message types as a ROS 2 package: whoever builds it speaks to us."""

import re
import xml.etree.ElementTree as ET

from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from bus_schema.messages import topics
from bus_schema.messages.types import PACKAGE, type_hash


def test_types_of_the_package_have_the_hashes_that_we_speak(funnel_hil, tmp_path):
    """Hashes as a ROS 2 distribution has them: rmw_zenoh's keys name them, and must be equal."""
    code, said = funnel_hil("ros-package", tmp_path)
    assert code == 0
    package = tmp_path / PACKAGE
    assert str(package) in said.replace("\n", "")
    store = get_typestore(Stores.ROS2_JAZZY)
    for file in sorted((package / "msg").glob("*.msg")):
        store.register(get_types_from_msg(file.read_text(), f"{PACKAGE}/msg/{file.stem}"))
    spoken = {topic.type_name for topic in topics.TOPICS if topic.type_name.startswith(PACKAGE)}
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
