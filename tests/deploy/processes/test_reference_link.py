"""The reference on the bus, as a client hears it that knows nothing of the scenario."""

from __future__ import annotations

import queue

import numpy as np

from bus_schema.messages.layout import parse
from bus_schema.messages.topics import JOINT_REFERENCE, JOINT_STATES
from bus_schema.messages.types import JOINT_STATE
from bus_schema.zenoh.session import ZenohSession
from controller.reference import sample_positions
from deploy.processes.network.reference_link import ReferenceLink
from deploy.scenario.scenario import load_setup
from tests.bus_schema.zenoh.zenoh_pair import (
    HANG_S,
    await_true,
    fresh_link,
    plant_on,
    state,
    status,
)


def test_reference_comes_before_each_state_with_its_stamp() -> None:
    setup = load_setup("paper_arm", ["link.publish_reference=true"])
    link = fresh_link().model_copy(update={"publish_reference": True})
    heard: queue.SimpleQueue[tuple[str, bytes]] = queue.SimpleQueue()
    with plant_on(link) as plant:
        client = ZenohSession([], [link.plant_endpoint], low_latency=False)
        for topic in (JOINT_REFERENCE, JOINT_STATES):
            key = topic.key_expression(0)
            client.subscribe(key, lambda d, name=topic.name: heard.put((name, d.payload)))
        referenced = ReferenceLink(plant, setup.reference, setup.robot.joint_names)
        await_true(plant._states.has_subscribers)

        def is_heard() -> bool:
            referenced.send_state(state(0), status())
            return not heard.empty()

        await_true(is_heard)
        referenced.send_state(state(1_250_000_000), status())
        while (said := heard.get(timeout=HANG_S))[1] != state(1_250_000_000):
            last = said
        client.close()
    name, payload = last
    message = parse(payload, JOINT_STATE)
    assert name == "joint_reference"
    assert (message.header.stamp.sec, message.header.stamp.nanosec) == (1, 250_000_000)
    (expected,) = sample_positions(setup.reference, np.array([1.25]), 3)
    assert message.position.tolist() == expected.tolist()
    assert message.velocity.any()
    assert len(message.effort) == 0
    assert list(message.name) == list(setup.robot.joint_names)
