"""What loops send in bundles comes to a recorder once, in order, and with all that others send."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import pytest

from bus_schema.messages import topics
from bus_schema.messages.run_event import EventKind, RunEvent
from bus_schema.messages.topics import Role
from bus_schema.zenoh.access import bundle_key_expression
from bus_schema.zenoh.bundles import Bundler, unbundled
from bus_schema.zenoh.link import ZenohPlantLink
from bus_schema.zenoh.ros_graph import Attachment, EntityKind, endpoint_token
from bus_schema.zenoh.session import ZenohSession
from tests.bus_schema.zenoh.recorder_ear import (
    ENDED,
    assert_received,
    ear_on,
    exchange,
    recorded_pair,
)
from tests.bus_schema.zenoh.zenoh_pair import (
    HANG_S,
    controller_on,
    foreign_session,
    fresh_link,
    plant_on,
)
from tests.waiting import await_true

FOREIGN = Attachment(7, 0, b"f" * 16)
NAMES = {topic.name.encode(): topic for topic in topics.TOPICS}


@contextmanager
def lone_bundler() -> Iterator[tuple[Bundler, list[bytes]]]:
    """A plant's bundler, and the bundles it has sent."""
    session = ZenohSession([], [], low_latency=False)
    taken: list[bytes] = []
    session.subscribe(bundle_key_expression(0), lambda delivery: taken.append(delivery.payload))
    yield Bundler(session, 0, Role.PLANT), taken
    session.close()


def hears_bundles_alone(plant: ZenohPlantLink) -> bool:
    """Nobody but a recorder subscribes to the status by itself."""
    return not plant.outbox._streams[topics.PLANT_STATUS.name].publisher.has_subscribers()


def test_recorder_takes_bundles_alone_while_none_but_both_loops_speak() -> None:
    with recorded_pair() as (plant, controller, ear):
        ear.await_true(lambda: hears_bundles_alone(plant))
        sent = exchange(plant, controller, range(100))
        ear.await_received(topics.RUN_EVENTS, 2)
        assert_received(ear, sent)


def test_each_message_comes_once_whenever_the_recorder_turns_to_bundles() -> None:
    link = fresh_link()
    with plant_on(link) as plant, ear_on(link, plant) as ear:
        await_true(lambda: not hears_bundles_alone(plant))
        with controller_on(link) as controller:
            controller.activate()
            controller.await_recorder(HANG_S)
            sent = [exchange(plant, controller, range(at, at + 50)) for at in range(0, 300, 50)]
            ear.await_received(topics.RUN_EVENTS, 12)
            assert_received(ear, *sent)


def test_bundle_of_the_controller_says_nothing_in_the_plants_name() -> None:
    with recorded_pair() as (_plant, controller, ear):
        bundler = controller._bundler
        assert bundler is not None
        bundler.add(b"plant_truth", FOREIGN.encode(), b"forged")
        forged = RunEvent(5, "plant", EventKind.ENDED, '{"completed": true}').encode()
        bundler.add(b"run_events", FOREIGN.encode(), forged)
        bundler.add(b"control_status", FOREIGN.encode(), b"its own")
        bundler.send()
        ear.await_received(topics.CONTROL_STATUS, 1)
        assert ear.received["plant_truth"] == ear.received["run_events"] == []
        assert ear.mailbox.rejected == {"wrong_role": 1}


@pytest.mark.parametrize("cut_off", [1, 5, 40, 60])
def test_what_is_no_bundle_is_taken_as_far_as_it_is_one(cut_off: int) -> None:
    with lone_bundler() as (bundler, taken):
        for number in range(3):
            bundler.add(b"plant_truth", FOREIGN.encode(), b"%d" % number)
        bundler.send()
        bundler.send()  # nothing more
        await_true(lambda: bool(taken))
    (bundle,) = taken
    sent = [(topics.PLANT_TRUTH, b"%d" % number, *FOREIGN) for number in range(3)]
    assert unbundled(bundle, NAMES) == sent
    assert unbundled(bundle[:-cut_off], NAMES) in (sent[:2], sent[:1])
    for garbage in (b"", b"\0" * 5, b"\xff" * 300, bundle[7:]):
        assert unbundled(garbage, NAMES) == []


@pytest.mark.parametrize(
    "attachment",
    [
        FOREIGN.encode(), FOREIGN.encode() + b"more", FOREIGN.encode()[:-1], b"", b"\xff" * 33,
        bytes(33), Attachment(-1, 0, FOREIGN.gid).encode(), Attachment(1, -1, FOREIGN.gid).encode(),
    ],
)  # fmt: skip
def test_attachments_in_bundles_are_read_as_those_of_messages_by_themselves(attachment):
    with lone_bundler() as (bundler, taken):
        bundler.add(b"plant_truth", attachment, b"truth")
        bundler.add(b"plant_truth", FOREIGN.encode(), b"next")
        bundler.send()
        await_true(lambda: bool(taken))
    alone = Attachment.decode(attachment) or Attachment(0, 0, b"")
    assert unbundled(taken[0], NAMES) == [
        (topics.PLANT_TRUTH, b"truth", *alone), (topics.PLANT_TRUTH, b"next", *FOREIGN),
    ]  # fmt: skip


def test_large_messages_do_not_wait_for_others() -> None:
    with lone_bundler() as (bundler, taken):
        bundler.add(b"plant_truth", FOREIGN.encode(), bytes(70_000))
        await_true(lambda: bool(taken))


@pytest.mark.parametrize("is_announced", [False, True], ids=["without a token", "with a token"])
@pytest.mark.parametrize("is_rejected", [False, True], ids=["alone", "beside a commander"])
def test_commands_of_strangers_come_as_the_plant_took_them_in(is_announced, is_rejected):
    """Each once, the very first too, whether the recorder turns to topics for it or not."""
    with recorded_pair() as (plant, _controller, ear):
        ear.await_true(lambda: hears_bundles_alone(plant))
        as_router = {"mode": "client", "connect/endpoints": [ear.link.plant_endpoint]}
        stranger, kept = foreign_session(as_router), []
        if is_announced:
            token = endpoint_token(
                0, str(stranger.zid()), "stranger", 1, EntityKind.PUBLISHER, topics.JOINT_COMMANDS
            )
            kept.append(stranger.liveliness().declare_token(token))

        def strike(numbers: range) -> None:
            for number in numbers:
                attachment = Attachment(number, 0, FOREIGN.gid).encode()
                key = topics.JOINT_COMMANDS.key_expression(0)
                stranger.put(key, b"strike %d" % number, attachment=attachment)
                stranger.put(key, b"without a sender")

        strike(range(1, 4))
        if is_announced:
            ear.await_true(lambda: not hears_bundles_alone(plant))
            status_key = topics.CONTROL_STATUS.key_expression(0)
            stranger.put(status_key, b"numbered", attachment=FOREIGN.encode())
            ear.await_received(topics.CONTROL_STATUS, 1)
        strike(range(4, 6))
        taken: list[bytes] = []

        def are_taken() -> bool:
            taken.extend(arrival.payload for arrival in plant.take_commands())
            return len(taken) == 10

        ear.await_true(are_taken)
        if is_rejected:
            plant.note_commander(b"the controller")
        plant.report()
        plant.publish(topics.RUN_EVENTS, ENDED[Role.PLANT])
        topic = topics.REJECTED_COMMANDS if is_rejected else topics.JOINT_COMMANDS
        ear.await_received(topic, 10)  # the event may come by itself, before them
        assert [payload for _, payload in ear.received[topic.name]] == taken
        stranger.close()  # type: ignore[no-untyped-call]


def test_message_too_large_for_the_transport_takes_no_others_along() -> None:
    with lone_bundler() as (bundler, taken):
        for payload in (b"before", bytes(2_000_000), b"after"):
            bundler.add(b"plant_truth", FOREIGN.encode(), payload)
        bundler.send()
        await_true(lambda: len(taken) == 3)
        assert [len(bundle) > 1_000_000 for bundle in taken] == [False, True, False]


@pytest.mark.parametrize("by_role", [False, True])
def test_with_keys_no_event_of_a_loop_is_believed_by_itself(by_role: bool) -> None:
    """Even before the loop is known: any key of the domain is enough to send one."""
    link = fresh_link()
    forged = RunEvent(5, "plant", EventKind.ENDED, '{"ticks": 1000, "completed": true}').encode()
    with plant_on(link), ear_on(link) as ear:
        ear.mailbox._by_role = by_role
        ear.await_true(lambda: Role.PLANT in ear.mailbox._have_bundled)
        ear.mailbox._have_bundled.clear()  # as if it had not announced itself yet
        client = {"mode": "client"}
        stranger = ZenohSession([], [link.plant_endpoint], low_latency=False, security=client)
        publisher = stranger.publisher(topics.RUN_EVENTS.key_expression(0))
        await_true(publisher.has_subscribers)
        publisher.put(forged, FOREIGN.encode())
        received = ear.received[topics.RUN_EVENTS.name]
        ear.await_true(lambda: bool(received or ear.mailbox.rejected))
        stranger.close()
        assert [payload for _, payload in received] == ([] if by_role else [forged])
        assert ear.mailbox.rejected == ({"wrong_role": 1} if by_role else {})
