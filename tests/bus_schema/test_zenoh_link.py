"""The link over Zenoh: between its own two sides, and with a client that others wrote.

The client is ``zenoh-ros2-sdk``, which speaks rmw_zenoh's format on its own: it computes keys,
type hashes, tokens and CDR itself. It keeps one session per process, so it has a process to itself.
"""

from __future__ import annotations

import json
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import pytest

from bus_schema import zenoh_link
from bus_schema.cdr_layout import Record
from bus_schema.clock import MonotonicClock
from bus_schema.errors import PeerSilentError
from bus_schema.link_configuration import LinkConfiguration
from bus_schema.topics import (
    CONTROL_STATUS,
    JOINT_COMMANDS,
    JOINT_STATES,
    PLANT_STATUS,
    layout,
)
from bus_schema.zenoh_link import ZenohControllerLink, ZenohPlantLink
from plant_emulator.command_gate import CommandGate

HANG_S = 60.0
JOINTS = ("base_yaw", "shoulder", "elbow")

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
    print(json.dumps(values), flush=True)

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
        info = get_topic_info("/joint_states", 0, "127.0.0.1", port, verbose=True)
        say(topics=dict(get_topic_names_and_types(0, "127.0.0.1", port)),
            publishers=[vars(endpoint) for endpoint in info.publishers] if info else [])
    else:
        import numpy as np
        stamp = order.pop("stamp")
        arrays = {key: np.array(order[key], float) for key in ("position", "velocity", "effort")}
        publisher.publish(header=Header(stamp=Time(*stamp), frame_id=""), name=order["name"],
                          **arrays)
"""


class Client:
    """The foreign client: told what to do, and heard, line by line."""

    def __init__(self, port: int) -> None:
        self._process = subprocess.Popen(
            [sys.executable, "-c", CLIENT, str(port)],
            stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True,
        )  # fmt: skip
        self.said: list[dict[str, Any]] = []
        threading.Thread(target=self._listen, daemon=True).start()

    def tell(self, order: Any) -> None:
        assert self._process.stdin is not None
        self._process.stdin.write(json.dumps(order) + "\n")
        self._process.stdin.flush()

    def await_said(self, key: str) -> dict[str, Any]:
        """The newest thing it said about `key`."""

        def matching() -> list[dict[str, Any]]:
            return [said for said in self.said if key in said]

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
                self.said.append(json.loads(line))


@pytest.fixture(scope="module")
def link() -> LinkConfiguration:
    return fresh_link()


@pytest.fixture(scope="module")
def foreign(link: LinkConfiguration) -> Iterator[tuple[ZenohPlantLink, Client]]:
    """A plant, and the foreign client connected to it."""
    with plant_on(link) as plant:
        client = Client(int(link.plant_endpoint.rpartition(":")[2]))
        try:
            client.await_said("hash")
            plant.await_controller(HANG_S)
            yield plant, client
        finally:
            client.end()


def test_foreign_client_computes_the_same_type_hash(
    foreign: tuple[ZenohPlantLink, Client],
) -> None:
    assert JOINT_STATES.key_expression(0).endswith(foreign[1].await_said("hash")["hash"])


def test_foreign_client_reads_our_joint_states(foreign: tuple[ZenohPlantLink, Client]) -> None:
    plant, client = foreign
    payload = state(stamp_ns=3_000_000_007, position=(0.1, -0.2, 0.3), effort=(1.0, 2.0, -3.0))

    def is_heard() -> bool:
        plant.send_state(payload, status())
        return any("position" in said for said in client.said)

    await_true(is_heard)
    assert client.await_said("position") == {
        "stamp": [3, 7],
        "name": list(JOINTS),
        "position": [0.1, -0.2, 0.3],
        "velocity": [0.0, 0.0, 0.0],
        "effort": [1.0, 2.0, -3.0],
    }


def test_foreign_client_sees_our_topics(foreign: tuple[ZenohPlantLink, Client]) -> None:
    client = foreign[1]
    client.tell("look around")
    seen = client.await_said("topics")
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
def test_command_of_a_foreign_controller_passes_the_gate(
    foreign: tuple[ZenohPlantLink, Client],
    name: tuple[str, ...], effort: list[float], others: list[float],
) -> None:  # fmt: skip
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


def test_state_and_reply_cross_the_link_with_their_bytes() -> None:
    link = fresh_link()
    reply = layout(JOINT_COMMANDS, JOINTS).template
    heard: list[tuple[bytes, bytes | None]] = []
    with plant_on(link) as plant, controller_on(link) as controller:

        def answer(payload: bytes, status: bytes | None) -> None:
            heard.append((payload, status))
            controller.publish(JOINT_COMMANDS, reply)
            controller.publish(CONTROL_STATUS, b"beside the point")

        controller.serve(answer)
        controller.take_command(await_recorder=False)
        plant.await_controller(HANG_S)
        for tick in range(50):
            plant.send_state(state(tick), status())
            assert plant.await_command(HANG_S)
            (arrival,) = plant.take_commands()
            assert arrival.payload == reply
            assert arrival.sequence == tick + 1  # numbers begin with 1 and have no gaps
            assert len(arrival.sender) == 16
    assert heard == [(state(tick), status()) for tick in range(50)]


def test_state_of_a_foreign_plant_comes_without_a_status() -> None:
    link = fresh_link()
    heard: list[bytes | None] = []
    with plant_on(link) as plant, controller_on(link) as controller:
        controller.serve(lambda _, status: heard.append(status))
        controller.take_command(await_recorder=False)
        plant.await_controller(HANG_S)
        plant.send_state(state(0), status())
        plant.publish(JOINT_STATES, state(1))
        plant.send_state(state(2), status())
        await_true(lambda: len(heard) == 3)
    assert heard == [status(), None, status()]


def test_plant_knows_when_its_controller_has_left() -> None:
    link = fresh_link()
    with plant_on(link) as plant:
        assert not plant.controller_has_left()  # nobody has come yet
        with controller_on(link) as controller:
            controller.take_command(await_recorder=False)
            plant.await_controller(HANG_S)
            assert not plant.controller_has_left()
        await_true(plant.controller_has_left)


def test_commander_is_followed_only_once_it_has_left() -> None:
    link = fresh_link()

    def command(controller: ZenohControllerLink, plant: ZenohPlantLink, stamp_ns: int) -> Any:
        record = Record(layout(JOINT_COMMANDS, JOINTS))
        record.stamp_ns = stamp_ns
        record.fields["effort"][:] = 1.0
        controller.publish(JOINT_COMMANDS, record.payload())
        assert plant.await_command(HANG_S)
        (arrival,) = plant.take_commands()
        return gate.admit(arrival, 100)

    with plant_on(link) as plant:
        gate = CommandGate(JOINTS, plant.sender_has_left)
        with controller_on(link) as first:
            first.take_command(await_recorder=False)
            plant.await_controller(HANG_S)
            assert command(first, plant, 1) is not None
        commander = gate.commander or b""
        await_true(lambda: plant.sender_has_left(commander))
        with controller_on(link) as again:  # the same controller, started again: a new session
            again.take_command(await_recorder=False)
            plant.await_controller(HANG_S)
            assert command(again, plant, 2) is not None
            assert gate.commander not in (None, commander)
    assert not gate.rejections.counts


def test_commands_beyond_the_largest_backlog_are_counted(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(zenoh_link, "_LARGEST_BACKLOG", 20)
    link, reply = fresh_link(), layout(JOINT_COMMANDS, JOINTS).template
    with plant_on(link) as plant, controller_on(link) as controller:
        controller.take_command(await_recorder=False)
        plant.await_controller(HANG_S)
        for _ in range(50):
            controller.publish(JOINT_COMMANDS, reply)
        await_true(lambda: plant.overflow() == 30)
        assert [arrival.sequence for arrival in plant.take_commands()] == list(range(1, 21))


def test_wait_for_a_controller_that_does_not_come_ends_in_an_error_that_names_it() -> None:
    with plant_on(fresh_link()) as plant:
        with pytest.raises(PeerSilentError, match="the controller is silent") as silence:
            plant.await_controller(0.1)
        assert silence.value.peer == "controller"
        assert not plant.await_command(0.01)
        plant.await_controller(HANG_S, lambda: True)  # a stop request ends the wait


def test_error_of_the_handler_ends_the_service_and_reaches_the_main_thread() -> None:
    link = fresh_link()

    def fail(_payload: bytes, _status: bytes | None) -> None:
        raise ZeroDivisionError

    with plant_on(link) as plant, controller_on(link) as controller:
        controller.serve(fail)
        controller.take_command(await_recorder=False)
        plant.await_controller(HANG_S)
        plant.send_state(state(0), status())
        with pytest.raises(ZeroDivisionError):
            controller.join(is_stop_requested=lambda: False)


@contextmanager
def plant_on(link: LinkConfiguration) -> Iterator[ZenohPlantLink]:
    plant = ZenohPlantLink(link, MonotonicClock(), lossless=True, await_recorder=False)
    try:
        yield plant
    finally:
        plant.close()


@contextmanager
def controller_on(link: LinkConfiguration) -> Iterator[ZenohControllerLink]:
    controller = ZenohControllerLink(link, lossless=True)
    try:
        yield controller
    finally:
        controller.close()


def fresh_link() -> LinkConfiguration:
    return LinkConfiguration(
        plant_endpoint=f"tcp/127.0.0.1:{free_port()}",
        controller_endpoint=f"tcp/127.0.0.1:{free_port()}",
        connect_timeout_s=HANG_S,
    )


def state(stamp_ns: int, **values: tuple[float, ...]) -> bytes:
    record = Record(layout(JOINT_STATES, JOINTS))
    record.stamp_ns = stamp_ns
    for name, value in values.items():
        record.fields[name][:] = value
    return record.payload()


def status() -> bytes:
    return layout(PLANT_STATUS, JOINTS).template


def await_true(condition: Callable[[], bool]) -> None:
    give_up_s = time.monotonic() + HANG_S
    while not condition():
        assert time.monotonic() < give_up_s, "waited in vain"
        time.sleep(0.01)


def free_port() -> int:
    with socket.socket() as listener:
        listener.bind(("127.0.0.1", 0))
        return int(listener.getsockname()[1])
