"""Nodes with rmw_zenoh's default configuration, which are peers and know a router alone."""

from __future__ import annotations

import threading
from collections import defaultdict
from collections.abc import Iterator
from itertools import count

import pytest
import zenoh
import zenoh.ext
from rosbags.typesys import Stores, get_typestore

from bus_schema.link.configuration import LinkConfiguration
from bus_schema.messages.run_event import EventKind, RunEvent
from bus_schema.messages.topics import (
    JOINT_STATES,
    PLANT_TRUTH,
    ROBOT_DESCRIPTION,
    RUN_EVENTS,
    TF,
    TF_STATIC,
    Role,
    layout,
)
from bus_schema.messages.types import STRING, TF_MESSAGE
from bus_schema.recording.mcap_log import read_log
from bus_schema.zenoh.link import ZenohPlantLink
from bus_schema.zenoh.ros_graph import Attachment
from deploy.run.processes.recorder import Recorder
from deploy.scenario.scenario import load_setup
from tests.bus_schema.zenoh.rmw_sessions import rmw_node, rmw_router
from tests.bus_schema.zenoh.zenoh_pair import (
    HANG_S,
    JOINTS,
    controller_on,
    fresh_link,
    plant_on,
    state,
    status,
)
from tests.waiting import await_true, free_endpoint


@pytest.fixture(scope="module")
def link() -> Iterator[LinkConfiguration]:
    router = free_endpoint()
    with rmw_router(router):
        yield fresh_link().model_copy(update={"router_endpoint": router})


@pytest.fixture(scope="module")
def plant(link: LinkConfiguration) -> Iterator[ZenohPlantLink]:
    with plant_on(link) as plant:
        yield plant


@pytest.fixture(scope="module")
def node(link: LinkConfiguration, plant: ZenohPlantLink) -> Iterator[zenoh.Session]:
    assert link.router_endpoint is not None
    with rmw_node(link.router_endpoint) as session:
        yield session


def test_node_sees_the_graph_and_hears_every_topic_without_a_gap(link, plant, node):
    tokens: set[str] = set()
    numbers: dict[str, list[int]] = {JOINT_STATES.name: [], PLANT_TRUTH.name: []}

    def hear(sample: zenoh.Sample) -> None:
        assert sample.attachment is not None
        attachment = Attachment.decode(sample.attachment.to_bytes())
        assert attachment is not None
        numbers[str(sample.key_expr).split("/")[1]].append(attachment.sequence)

    watch = node.liveliness().declare_subscriber(
        "@ros2_lv/0/**", lambda sample: tokens.add(str(sample.key_expr)), history=True
    )
    hears = [
        node.declare_subscriber(topic.key_expression(0), hear)
        for topic in (JOINT_STATES, PLANT_TRUTH)
    ]
    with controller_on(link):
        expected = {"funnel_hil_plant", "funnel_hil_controller"}
        await_true(lambda: {t.split("/")[8] for t in tokens if t.split("/")[5] == "NN"} >= expected)
    await_true(plant._states.has_subscribers)

    def is_received() -> bool:
        plant.send_state(state(0), status())
        return bool(numbers[JOINT_STATES.name])

    await_true(is_received)  # routes follow what is declared
    for _ in range(640):
        plant.send_state(state(0), status())
        plant.publish(PLANT_TRUTH, layout(PLANT_TRUTH, JOINTS).template)
    # As at the end of a run, an event takes along what waits for more of its kind.
    plant.publish(RUN_EVENTS, RunEvent(0, Role.PLANT, EventKind.ENDED, "").encode())
    await_true(lambda: len(numbers[PLANT_TRUTH.name]) == 640)
    received = numbers[JOINT_STATES.name]
    await_true(lambda: received[-1] - received[0] >= 640)
    assert received == list(range(received[0], received[-1] + 1))
    for declared in (*hears, watch):
        declared.undeclare()


def test_node_that_comes_late_gets_the_arm_and_sees_it_move(link, plant, node, tmp_path):
    """As RViz subscribes: transient local for robot_description and tf_static, volatile for tf."""
    places = {key: str(value) for key, value in link.model_dump(exclude_unset=True).items()}
    overrides = [f"link.{key}={value}" for key, value in places.items()]
    recorder = Recorder(load_setup("paper_arm", overrides), tmp_path / "run.mcap")
    is_over = threading.Event()
    thread = threading.Thread(target=recorder.run, args=(is_over.is_set,))
    thread.start()
    received: defaultdict[str, list[bytes]] = defaultdict(list)

    def hear(sample: zenoh.Sample) -> None:
        assert sample.attachment is not None
        assert Attachment.decode(sample.attachment.to_bytes()) is not None
        received[str(sample.key_expr).split("/")[1]].append(sample.payload.to_bytes())

    late = zenoh.ext.HistoryConfig(detect_late_publishers=True, max_samples=1)
    ears = [
        zenoh.ext.declare_advanced_subscriber(node, topic.key_expression(0), hear, history=late)
        for topic in (ROBOT_DESCRIPTION, TF_STATIC)
    ]
    ear = node.declare_subscriber(TF.key_expression(0), hear)
    stamps_ns = count(0, 20_000_000)

    def is_seen() -> bool:
        plant.send_state(state(next(stamps_ns)), status())
        return received.keys() == {"robot_description", "tf_static", "tf"}

    await_true(is_seen)
    is_over.set()
    thread.join(HANG_S)
    recorder.close()
    ros = get_typestore(Stores.ROS2_JAZZY)
    (description,) = received["robot_description"]
    assert "<robot" in ros.deserialize_cdr(description, STRING).data
    moving = ros.deserialize_cdr(received["tf"][-1], TF_MESSAGE).transforms
    assert [each.child_frame_id for each in moving] == ["column", "upper_arm", "forearm"]
    kept = read_log(tmp_path / "run.mcap").payloads
    assert kept["robot_description"] == [description]
    assert set(received["tf"]) <= set(kept["tf"])
    for declared in (*ears, ear):
        declared.undeclare()
