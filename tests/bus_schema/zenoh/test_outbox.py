"""What waits for more of its kind, and for how long."""

from __future__ import annotations

import time
from collections.abc import Iterator

import pytest

from bus_schema.messages.run_event import EventKind, RunEvent
from bus_schema.messages.topics import PLANT_TRUTH, RUN_EVENTS, Role
from bus_schema.zenoh import outbox
from bus_schema.zenoh.link import ZenohPlantLink
from bus_schema.zenoh.session import Delivery, ZenohSession
from tests.bus_schema.zenoh.zenoh_pair import await_true, fresh_link, plant_on

LONGER_THAN_A_BATCH_WAITS_S = 0.03
EVENT = RunEvent(0, Role.PLANT, EventKind.STARTED, "").encode()


@pytest.fixture
def heard() -> list[Delivery]:
    """Truth that a viewer has heard."""
    return []


@pytest.fixture
def plant(heard: list[Delivery]) -> Iterator[ZenohPlantLink]:
    """A plant with that viewer, to which its messages come, and of which none waits."""
    link = fresh_link()
    with plant_on(link) as plant:
        viewer = ZenohSession([], [link.plant_endpoint], low_latency=False)
        viewer.subscribe(PLANT_TRUTH.key_expression(0), heard.append)

        def is_heard() -> bool:
            plant.publish(PLANT_TRUTH, b"a try")
            plant.publish(RUN_EVENTS, EVENT)
            return bool(heard)

        await_true(is_heard)
        plant.publish(PLANT_TRUTH, b"the last try")
        plant.publish(RUN_EVENTS, EVENT)
        await_true(lambda: heard[-1].payload == b"the last try")
        heard.clear()
        yield plant
        viewer.close()


def test_ticks_far_apart_do_not_wait_for_a_whole_batch(
    plant: ZenohPlantLink, heard: list[Delivery]
) -> None:
    plant.publish(PLANT_TRUTH, b"1")
    time.sleep(LONGER_THAN_A_BATCH_WAITS_S)
    plant.publish(PLANT_TRUTH, b"2")
    await_true(lambda: [message.payload for message in heard] == [b"1", b"2"])


def test_an_event_takes_along_what_waits(
    plant: ZenohPlantLink, heard: list[Delivery], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(outbox, "_LONGEST_WAIT_NS", 1 << 62)
    plant.publish(PLANT_TRUTH, b"1")
    plant.publish(RUN_EVENTS, EVENT)
    await_true(lambda: [message.payload for message in heard] == [b"1"])
