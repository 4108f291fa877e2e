"""What waits for more of its kind, and for how long."""

from __future__ import annotations

import time

from bus_schema.messages.run_event import EventKind, RunEvent
from bus_schema.messages.topics import PLANT_TRUTH, RUN_EVENTS, Role
from bus_schema.zenoh.session import ZenohSession
from tests.bus_schema.zenoh.zenoh_pair import await_true, fresh_link, plant_on

LONGER_THAN_A_BATCH_WAITS_S = 0.03


def test_ticks_far_apart_do_not_wait_for_a_whole_batch() -> None:
    link, heard = fresh_link(), []
    with plant_on(link) as plant:
        viewer = ZenohSession([], [link.plant_endpoint], low_latency=False)
        viewer.subscribe(PLANT_TRUTH.key_expression(0), lambda message: heard.append(message))
        truth = plant._outbox._streams[PLANT_TRUTH.name].publisher
        await_true(truth.has_subscribers)

        def is_heard() -> bool:
            plant.publish(PLANT_TRUTH, b"slow")
            time.sleep(LONGER_THAN_A_BATCH_WAITS_S)
            return bool(heard)

        await_true(is_heard)  # routes follow what is declared
        before = len(heard)
        await_true(lambda: is_heard() and len(heard) > before + 3)
        viewer.close()


def test_an_event_takes_along_what_waits() -> None:
    link, heard = fresh_link(), []
    with plant_on(link) as plant:
        viewer = ZenohSession([], [link.plant_endpoint], low_latency=False)
        viewer.subscribe(PLANT_TRUTH.key_expression(0), lambda message: heard.append(message))
        truth = plant._outbox._streams[PLANT_TRUTH.name].publisher
        await_true(truth.has_subscribers)

        def is_heard() -> bool:
            plant.publish(PLANT_TRUTH, b"before the event")
            plant.publish(RUN_EVENTS, RunEvent(0, Role.PLANT, EventKind.STARTED, "").encode())
            return bool(heard)

        await_true(is_heard)
        viewer.close()
