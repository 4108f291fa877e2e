"""Transforms as viewers chain them are where the physics has the links."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from pathlib import Path

import numpy as np
import pinocchio
import pytest
from rosbags.typesys import Stores, get_typestore

from bus_schema.messages.record import Record
from bus_schema.messages.topics import JOINT_STATES, VIEW_TOPICS, layout
from bus_schema.messages.types import STRING, TF_MESSAGE, type_hash
from bus_schema.robot_description import RobotDescription, load_robot
from bus_schema.view.arm_view import ArmView
from tests.arms import PYBULLET_DATA, needs_pybullet_data

ROS = get_typestore(Stores.ROS2_JAZZY)
PERIOD_NS = 1_000_000_000 // 60
ARMS = [
    "deploy/robots/paper_arm.urdf",
    "deploy/robots/iiwa.urdf",
    "deploy/robots/panda.urdf",
    pytest.param(PYBULLET_DATA / "xarm/xarm6_robot.urdf", marks=needs_pybullet_data),
    pytest.param(PYBULLET_DATA / "cartpole.urdf", marks=needs_pybullet_data),  # slides
]


def arm(path: str | Path) -> RobotDescription:
    return load_robot(Path(path), repair=True)


def state_of(robot: RobotDescription, position: np.ndarray, stamp_ns: int) -> bytes:
    record = Record(layout(JOINT_STATES, robot.joint_names))
    record.stamp_ns = stamp_ns
    record.fields["position"][:] = position
    return record.payload()


def chained(robot: RobotDescription, position: np.ndarray) -> dict[str, np.ndarray]:
    """Pose of each link in the base's frame, as a matrix, as ROS's own types decode and chain."""
    view = ArmView(robot)
    (_, _), (_, static) = view.first()
    moving = view.transforms(state_of(robot, position, 5), 5)
    assert moving is not None
    carried = {}
    for payload in (static, moving):
        for each in ROS.deserialize_cdr(payload, TF_MESSAGE).transforms:
            pose, turn = each.transform.translation, each.transform.rotation
            quaternion = pinocchio.Quaternion(turn.w, turn.x, turn.y, turn.z)
            assert quaternion.norm() == pytest.approx(1.0, abs=1e-12)
            placement = pinocchio.SE3(quaternion, np.array([pose.x, pose.y, pose.z]))
            carried[each.child_frame_id] = (each.header.frame_id, placement.homogeneous)

    def in_base(link: str) -> np.ndarray:
        if link not in carried:
            return np.eye(4)
        parent, pose = carried[link]
        return in_base(parent) @ pose

    return {link: in_base(link) for link in carried}


@pytest.mark.parametrize("path", ARMS, ids=lambda path: Path(path).stem)
def test_links_are_where_pinocchio_has_them(path: str | Path) -> None:
    robot = arm(path)
    links = {each.get("name") for each in ET.fromstring(robot.text).findall("link")}
    model = pinocchio.buildModelFromXML(robot.resolved_urdf(shapes="none"))
    data = model.createData()
    generator = np.random.default_rng(7)
    for _ in range(5):
        position = generator.uniform(-1.5, 1.5, robot.joints)
        q = np.zeros(model.nq)
        for name, p in robot.joint_positions(position).items():
            q[model.joints[model.getJointId(name)].idx_q] = p
        pinocchio.framesForwardKinematics(model, data, q)
        found = chained(robot, position)
        assert found.keys() < links
        assert len(found) == len(links) - 1  # all but the base are carried
        for link, pose in found.items():
            frame = model.getFrameId(link, pinocchio.FrameType.BODY)
            np.testing.assert_allclose(pose, data.oMf[frame].homogeneous, atol=1e-12)


def test_types_and_qos_are_those_of_ros() -> None:
    for topic in VIEW_TOPICS:
        assert type_hash(topic.type_name) == ROS.hash_rihs01(topic.type_name)
    assert [topic.qos for topic in VIEW_TOPICS] == [
        ":1:,1:,:,:,,", ":1:,1:,:,:,,", "::,100:,:,:,,",
    ]  # fmt: skip


def test_meshes_have_uris_and_missing_ones_are_left_out(tmp_path: Path) -> None:
    (tmp_path / "here it is.stl").write_text("solid x")
    text = Path("deploy/robots/paper_arm.urdf").read_text()
    shapes = "".join(
        f'<visual><geometry><mesh filename="{name}"/></geometry></visual>'
        for name in ("here it is.stl", "package://nowhere/else.stl")
    )
    file = tmp_path / "arm.urdf"
    file.write_text(text.replace("</link>", shapes + "</link>", 1))
    (_, description), _ = ArmView(arm(file)).first()
    root = ET.fromstring(ROS.deserialize_cdr(description, STRING).data)
    assert [mesh.get("filename") for mesh in root.iter("mesh")] == [
        (tmp_path / "here it is.stl").as_uri()
    ]


def test_images_come_at_the_rate_of_a_viewer_with_any_clock() -> None:
    robot = arm("deploy/robots/paper_arm.urdf")
    view = ArmView(robot)

    def is_shown(stamp_ns: int) -> bool:
        return view.transforms(state_of(robot, np.zeros(3), stamp_ns), stamp_ns) is not None

    shown = [stamp for stamp in range(0, 1_000_000_000, 1_000_000) if is_shown(stamp)]
    assert 50 <= len(shown) <= 60
    assert np.diff(shown).min() >= PERIOD_NS
    assert not is_shown(shown[-1])  # once more
    assert is_shown(10**15)
    assert is_shown(0)  # a clock that was set back
    assert view.transforms(b"nonsense", 10**12) is None
    assert view.transforms(state_of(robot, np.full(3, np.nan), 10**12), 10**12) is None
