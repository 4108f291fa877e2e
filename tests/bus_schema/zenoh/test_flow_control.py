"""A sender waits for recorders that are too far behind, and for those alone."""

from __future__ import annotations

import logging
import threading

import pytest

from bus_schema.messages.topics import PLANT_TRUTH
from bus_schema.zenoh.outbox import LARGEST_LEAD_BYTES, FlowControl
from tests.bus_schema.zenoh.recorder_ear import ear_on
from tests.bus_schema.zenoh.zenoh_pair import HANG_S, fresh_link, plant_on

TOO_MUCH = LARGEST_LEAD_BYTES + 1
NEVER_S = 0.0


def must_wait(flow: FlowControl) -> bool:
    """Whether a sender would have to wait now. Whom it waits for is forgotten by that."""
    before = dict(flow.recorders)
    flow.await_recorders()
    return flow.recorders != before


def test_without_a_recorder_no_process_waits_for_one() -> None:
    flow = FlowControl(NEVER_S)
    for mark in range(1, 4):
        flow.send(TOO_MUCH, mark)
        flow.await_recorders()
    assert not flow._marks  # they would grow for hours


def test_recorder_that_never_reported_is_awaited_for_less_time():
    flow = FlowControl(HANG_S, NEVER_S)
    flow.join("recorder")
    flow.send(1, 1)
    flow.acknowledge("recorder", 2**62)  # it cannot be further than what was sent
    flow.join("stranger")
    flow.send(TOO_MUCH, 2)
    threading.Timer(0.05, flow.acknowledge, ("recorder", 2)).start()
    flow.await_recorders()
    flow.await_recorders()
    assert flow.recorders == {"recorder": 2}


HALF = TOO_MUCH // 2
WAITS = {
    "less than the largest lead": ("join recorder", (HALF, 1), (1000,), False),
    "far behind": ("join recorder", (HALF, 1), (1000,), (HALF, 2), True),
    "caught up, with a late and a false report": (
        "join recorder", (HALF, 1), (HALF, 2), (HALF, 3), ("recorder", 2), ("recorder", 1),
        ("stranger", 9), False,
    ),
    "sent before both came": ((TOO_MUCH, 1), "join quick", "join slow", False),
    "the slowest of two": ("join quick", "join slow", (TOO_MUCH, 2), ("quick", 2), True),
    "the slowest has left": (
        "join quick", "join slow", (TOO_MUCH, 2), ("quick", 2), "leave slow", False
    ),
}  # fmt: skip
"""Arrivals, departures, bytes sent with their marks, reports; and whether the sender waits."""


@pytest.mark.parametrize("case", WAITS)
def test_sender_waits_for_recorders_that_are_far_behind(case):
    flow = FlowControl(NEVER_S)
    *steps, waits = WAITS[case]
    for step in steps:
        if isinstance(step, str):
            action, recorder = step.split()
            getattr(flow, action)(recorder)
        else:
            (flow.acknowledge if isinstance(step[0], str) else flow.send)(*step)
    assert must_wait(flow) is waits


def test_recorder_that_never_answers_is_abandoned_and_reported(caplog):
    flow = FlowControl(patience_s=0.01)
    flow.join("recorder")
    flow.send(TOO_MUCH, 1)
    with caplog.at_level(logging.WARNING):
        flow.await_recorders()
        flow.await_recorders()
    assert caplog.messages == [
        "a recorder has recorded nothing for 0.01 s, and is waited for no longer: what it misses it"
        " counts as lost"
    ]


def test_all_recorders_that_never_answer_cost_one_wait_and_later_ones_none(caplog):
    flow = FlowControl(patience_s=0.01)
    for name in ("false", "also false", "false again"):
        flow.join(name)
    flow.send(TOO_MUCH, 1)
    with caplog.at_level(logging.WARNING):
        flow.await_recorders()
        assert not must_wait(flow)
        flow.join("late and false")
        flow.send(TOO_MUCH, 2)
        flow.await_recorders()
    assert [message.split(",")[0] for message in caplog.messages] == [
        "a recorder has recorded nothing for 0.01 s",
        "a recorder has recorded nothing for 0 s",
    ]


def test_recorder_that_joined_just_now_is_not_abandoned_with_others() -> None:
    flow = FlowControl(patience_s=0.01)
    flow.join("false")
    flow.send(TOO_MUCH, 1)
    flow.join("genuine")
    flow.await_recorders()
    flow.acknowledge("genuine", 1)
    flow.send(TOO_MUCH, 2)
    flow.acknowledge("genuine", 1)
    assert flow.recorders.keys() == {"genuine"}


def test_plant_waits_until_a_recorder_confirms_the_messages() -> None:
    link, payload, batch, batches = fresh_link(), bytes(20_000), 32, 5
    assert batch * len(payload) > LARGEST_LEAD_BYTES
    with plant_on(link) as plant, ear_on(link, plant) as ear:

        def send() -> None:
            for _ in range(batch * batches):
                plant.publish(PLANT_TRUTH, payload)

        sender = threading.Thread(target=send)
        sender.start()
        gid = plant.outbox.gid_of(PLANT_TRUTH)
        assert gid is not None
        for number in range(1, batches + 1):
            ear.await_received(PLANT_TRUTH, number * batch)
            assert sender.is_alive()
            ear.node.tell_progress(gid, number * batch)
        sender.join(HANG_S)
        assert not sender.is_alive()
