"""The link over Zenoh with a client that others wrote.

The client is ``zenoh-ros2-sdk``, which speaks rmw_zenoh's format on its own: it computes keys,
type hashes, tokens and CDR itself. It keeps one session per process, so it has a process to itself.
"""

from __future__ import annotations

import json
import subprocess
import sys
import threading
from collections.abc import Iterator
from typing import Any

import pytest

from bus_schema.link.configuration import LinkConfiguration
from bus_schema.zenoh.link import ZenohPlantLink
from plant_emulator.command_gate import CommandGate
from tests.bus_schema.zenoh.zenoh_pair import HANG_S, JOINTS, fresh_link, plant_on, state, status
from tests.waiting import await_true

CLIENT = r"""
import json, sys, time
from zenoh_ros2_sdk import ROS2Publisher, ROS2Subscriber, ZenohSession, get_topic_info, \
    get_topic_names_and_types
from zenoh_ros2_sdk.utils import get_type_hash

TIME = "int32 sec\nuint32 nanosec\n"
HEADER = "builtin_interfaces/Time stamp\nstring frame_id\n"
JOINT_STATE = "std_msgs/Header header\nstring[] name\nfloat64[] position\n" \
    "float64[] velocity\nfloat64[] effort\n"
TYPE = "sensor_msgs/msg/JointState"
port = int(sys.argv[1])
session = ZenohSession.get_instance("127.0.0.1", port)
Time = session.register_message_type(TIME, "builtin_interfaces/msg/Time")
Header = session.register_message_type(HEADER, "std_msgs/msg/Header")
hash_ = get_type_hash(TYPE, JOINT_STATE, {
    "builtin_interfaces/msg/Time": TIME, "std_msgs/msg/Header": HEADER})
common = {"msg_type": TYPE, "msg_definition": JOINT_STATE, "type_hash": hash_, "domain_id": 0,
          "router_ip": "127.0.0.1", "router_port": port}

def say(**values):
    sys.stdout.write(json.dumps(values) + "\n")  # in one go: other threads write too
    sys.stdout.flush()

def hear(message):
    say(stamp=[message.header.stamp.sec, message.header.stamp.nanosec], name=list(message.name),
        position=list(message.position), velocity=list(message.velocity),
        effort=list(message.effort))

subscriber = ROS2Subscriber(topic="/joint_states", callback=hear, **common)
publisher = ROS2Publisher(topic="/joint_commands", **common)
say(hash=hash_)
for line in sys.stdin:
    order = json.loads(line)
    if order == "look around":
        patient = {"timeout": 60.0}  # it ends with the last answer; by default in half a second
        info = get_topic_info("/joint_states", 0, "127.0.0.1", port, verbose=True, **patient)
        say(topics=dict(get_topic_names_and_types(0, "127.0.0.1", port, **patient)),
            publishers=[vars(endpoint) for endpoint in info.publishers] if info else [])
    else:
        import numpy as np
        stamp = order.pop("stamp")
        arrays = {key: np.array(order[key], float) for key in ("position", "velocity", "effort")}
        publisher.publish(header=Header(stamp=Time(*stamp), frame_id=""), name=order["name"],
                          **arrays)
"""


class Client:
    """The foreign client: it takes orders and answers, line by line."""

    def __init__(self, port: int) -> None:
        self._process = subprocess.Popen(
            [sys.executable, "-c", CLIENT, str(port)],
            stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True,
        )  # fmt: skip
        self.answers: list[dict[str, Any]] = []
        threading.Thread(target=self._listen, daemon=True).start()

    def tell(self, order: Any) -> None:
        assert self._process.stdin is not None
        self._process.stdin.write(json.dumps(order) + "\n")
        self._process.stdin.flush()

    def await_answer(self, key: str) -> dict[str, Any]:
        """Return its newest answer with `key`."""

        def matching() -> list[dict[str, Any]]:
            return [text for text in self.answers if key in text]

        await_true(lambda: bool(matching()) or self._process.poll() is not None)
        assert matching(), "the client has died"
        return matching()[-1]

    def end(self) -> None:
        self._process.kill()
        self._process.wait()

    def _listen(self) -> None:
        assert self._process.stdout is not None
        for line in self._process.stdout:
            if line.startswith("{"):
                self.answers.append(json.loads(line))


@pytest.fixture(scope="module")
def link() -> LinkConfiguration:
    return fresh_link()


@pytest.fixture(scope="module")
def foreign(link: LinkConfiguration) -> Iterator[tuple[ZenohPlantLink, Client]]:
    """A plant, and the foreign client connected to it."""
    with plant_on(link) as plant:
        client = Client(int(link.plant_endpoint.rpartition(":")[2]))
        try:
            client.await_answer("hash")
            plant.await_controller(HANG_S)
            yield plant, client
        finally:
            client.end()


def test_foreign_client_reads_our_joint_states(foreign: tuple[ZenohPlantLink, Client]) -> None:
    plant, client = foreign
    payload = state(stamp_ns=3_000_000_007, position=(0.1, -0.2, 0.3), effort=(1.0, 2.0, -3.0))

    def is_received() -> bool:
        plant.send_state(payload, status())
        return any("position" in text for text in client.answers)

    await_true(is_received)
    assert client.await_answer("position") == {
        "stamp": [3, 7],
        "name": list(JOINTS),
        "position": [0.1, -0.2, 0.3],
        "velocity": [0.0, 0.0, 0.0],
        "effort": [1.0, 2.0, -3.0],
    }


def test_foreign_client_sees_our_topics(foreign: tuple[ZenohPlantLink, Client]) -> None:
    client = foreign[1]
    client.tell("look around")
    seen = client.await_answer("topics")
    assert seen["topics"] == {
        "/joint_commands": ["sensor_msgs/msg/JointState"],
        "/joint_states": ["sensor_msgs/msg/JointState"],
        "/plant_status": ["funnel_hil_msgs/msg/PlantStatus"],
        "/plant_truth": ["funnel_hil_msgs/msg/PlantTruth"],
        "/run_events": ["funnel_hil_msgs/msg/RunEvent"],
    }
    (publisher,) = seen["publishers"]
    assert publisher["node_name"].strip("/") == "funnel_hil_plant"
    assert publisher["topic_type"] == "sensor_msgs/msg/JointState"
    assert publisher["qos"] == "::,10:,:,:,,"


@pytest.mark.parametrize(
    ("name", "effort"),
    [(JOINTS, [1.0, 2.0, 3.0]), (("elbow", "base_yaw", "shoulder"), [3.0, 1.0, 2.0])],
    ids=["our order", "its own order"],
)
@pytest.mark.parametrize("others", [[], [0.0, 0.0, 0.0]], ids=["torques alone", "all fields"])
def test_command_of_a_foreign_controller_passes_the_gate(foreign, name, effort, others):
    plant, client = foreign
    client.tell(
        {"stamp": [5, 6], "name": name, "position": others, "velocity": others, "effort": effort}
    )
    assert plant.await_command(HANG_S)
    (arrival,) = plant.take_commands()
    command = CommandGate(JOINTS).admit(arrival, newest_state_ns=5_000_000_006)
    assert command is not None
    assert command.torque_nm.tolist() == [1.0, 2.0, 3.0]
    assert command.stamp_ns == 5_000_000_006
