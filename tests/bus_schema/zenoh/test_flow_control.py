"""A sender waits for recorders that are too far behind, and for those alone."""

from __future__ import annotations

import logging
import threading

from bus_schema.messages.topics import PLANT_TRUTH
from bus_schema.zenoh import outbox
from bus_schema.zenoh.outbox import LARGEST_LEAD_BYTES, FlowControl
from tests.bus_schema.zenoh.recorder_ear import ear_on
from tests.bus_schema.zenoh.zenoh_pair import HANG_S, fresh_link, plant_on

TOO_MUCH = LARGEST_LEAD_BYTES + 1
NEVER_S = 0.0


def must_wait(flow: FlowControl) -> bool:
    """Whether a sender would have to wait now. Whom it waits for is forgotten by that."""
    before = dict(flow._recorders)
    flow.await_recorders()
    return flow._recorders != before


def test_without_a_recorder_no_process_waits_for_one() -> None:
    flow = FlowControl(NEVER_S)
    for mark in range(1, 4):
        flow.send(TOO_MUCH, mark)
        flow.await_recorders()
    assert not flow._marks  # they would grow for hours


def test_a_recorder_far_behind_is_waited_for() -> None:
    flow = FlowControl(NEVER_S)
    flow.join("recorder")
    flow.send(TOO_MUCH // 2, 1)
    flow.send(1000)
    assert not must_wait(flow)
    flow.send(TOO_MUCH // 2, 2)
    assert must_wait(flow)


def test_recorder_that_never_reported_is_awaited_for_less_time(monkeypatch):
    monkeypatch.setattr(outbox, "_FIRST_PATIENCE_S", NEVER_S)
    flow = FlowControl(HANG_S)
    flow.join("recorder")
    flow.send(1, 1)
    flow.acknowledge("recorder", 2**62)  # it cannot be further than what was sent
    flow.join("stranger")
    flow.send(TOO_MUCH, 2)
    threading.Timer(0.05, flow.acknowledge, ("recorder", 2)).start()
    flow.await_recorders()
    flow.await_recorders()
    assert flow._recorders == {"recorder": 2}


def test_a_recorder_that_has_caught_up_is_not() -> None:
    flow = FlowControl(NEVER_S)
    flow.join("recorder")
    for mark in (1, 2, 3):
        flow.send(TOO_MUCH // 2, mark)
    flow.acknowledge("recorder", 2)
    flow.acknowledge("recorder", 1)  # late
    flow.acknowledge("stranger", 9)
    assert not must_wait(flow)


def test_the_slowest_of_several_counts_while_it_is_there() -> None:
    flow = FlowControl(NEVER_S)
    flow.send(TOO_MUCH, 1)
    for recorder in ("quick", "slow"):
        flow.join(recorder)  # what was sent before is none of theirs
    assert not must_wait(flow)
    flow.send(TOO_MUCH, 2)
    flow.acknowledge("quick", 2)
    flow.leave("slow")
    assert not must_wait(flow)


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
    assert flow._recorders.keys() == {"genuine"}


def test_plant_waits_until_a_recorder_confirms_the_messages() -> None:
    link, payload, batch, batches = fresh_link(), bytes(20_000), 32, 5
    assert batch * len(payload) > LARGEST_LEAD_BYTES
    with plant_on(link) as plant, ear_on(link, plant) as ear:

        def send() -> None:
            for _ in range(batch * batches):
                plant.publish(PLANT_TRUTH, payload)

        sender = threading.Thread(target=send)
        sender.start()
        gid = plant._outbox.gid_of(PLANT_TRUTH)
        assert gid is not None
        for number in range(1, batches + 1):
            ear.await_received(PLANT_TRUTH, number * batch)
            assert sender.is_alive()
            ear.node.tell_progress(gid, number * batch)
        sender.join(HANG_S)
        assert not sender.is_alive()
