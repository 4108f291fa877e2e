"""The link over Zenoh, between its own two sides."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import pytest

from bus_schema.errors import PeerSilentError
from bus_schema.link.configuration import LinkConfiguration
from bus_schema.messages.layout import Record
from bus_schema.messages.run_event import COMMANDS_RECEIVED
from bus_schema.messages.topics import (
    CONTROL_STATUS,
    JOINT_COMMANDS,
    JOINT_REFERENCE,
    JOINT_STATES,
    Role,
    layout,
)
from bus_schema.runtime.clock import MonotonicClock
from bus_schema.zenoh import arrivals
from bus_schema.zenoh import link as zenoh_link
from bus_schema.zenoh.link import ZenohControllerLink, ZenohPlantLink
from bus_schema.zenoh.node import ZenohNode
from bus_schema.zenoh.session import Inbox, ZenohSession
from plant_emulator.command_gate import CommandGate
from tests.bus_schema.zenoh.zenoh_pair import (
    HANG_S,
    JOINTS,
    await_true,
    controller_on,
    fresh_link,
    plant_on,
    spinning,
    state,
    status,
)


@pytest.mark.parametrize("lockstep", [True, False], ids=["lockstep", "real time"])
def test_state_and_reply_cross_the_link_with_their_bytes(lockstep: bool) -> None:
    link = fresh_link()
    reply = layout(JOINT_COMMANDS, JOINTS).template
    heard: list[tuple[bytes, bytes | None]] = []
    with plant_on(link, lockstep=lockstep) as plant, controller_on(link) as controller:

        def answer(payload: bytes, status: bytes | None) -> None:
            heard.append((payload, status))
            controller.publish(JOINT_COMMANDS, reply)
            controller.publish(CONTROL_STATUS, b"beside the point")

        controller.serve(answer)
        controller.activate()
        plant.await_controller(HANG_S)
        with spinning(controller):
            for tick in range(50):
                plant.send_state(state(tick), status())
                assert plant.await_command(HANG_S)
                (arrival,) = plant.take_commands()
                assert arrival.payload == reply
                assert arrival.sequence == tick + 1  # numbers begin with 1 and have no gaps
                assert len(arrival.sender) == 16
    assert heard == [(state(tick), status()) for tick in range(50)]


def test_controller_that_joins_a_run_under_way_answers_once_it_is_in_command() -> None:
    link, reply = fresh_link(), layout(JOINT_COMMANDS, JOINTS).template
    with plant_on(link) as plant, controller_on(link) as controller:

        def answer(_payload: bytes, _status: bytes | None) -> None:
            controller.publish(JOINT_COMMANDS, reply)

        controller.serve(answer)
        await_true(lambda: plant.sees(Role.CONTROLLER))
        for tick in range(3):
            plant.send_state(state(tick), status())
        plant.advertise(JOINT_REFERENCE)  # comes behind the states, on the same connection
        await_true(lambda: controller.has_publisher(JOINT_REFERENCE))
        controller.activate()
        plant.await_controller(HANG_S)
        with spinning(controller):
            plant.send_state(state(3), status())
            assert plant.await_command(HANG_S)
        assert [arrival.sequence for arrival in plant.take_commands()] == [1]


def test_state_of_a_foreign_plant_comes_without_a_status() -> None:
    link = fresh_link()
    heard: list[bytes | None] = []
    with plant_on(link) as plant, controller_on(link) as controller:
        controller.serve(lambda _, status: heard.append(status))
        controller.activate()
        plant.await_controller(HANG_S)
        with spinning(controller):
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
            controller.activate()
            plant.await_controller(HANG_S)
            assert not plant.controller_has_left()
        await_true(plant.controller_has_left)


def test_controller_knows_of_a_plant_that_came_and_left_between_two_looks() -> None:
    """A run in lockstep may be over in 15 ms; then it was 6 s until the plant counted as silent."""
    link = fresh_link()
    with controller_on(link.model_copy(update={"connect_timeout_s": 0.0})) as controller:
        controller.activate()
        with plant_on(link):
            await_true(lambda: controller.sees(Role.PLANT))
        await_true(lambda: not controller.sees(Role.PLANT))
        controller.spin()


@pytest.mark.parametrize("lockstep", [True, False], ids=["lockstep", "real time"])
def test_plant_leaves_in_the_midst_of_a_flood(
    monkeypatch: pytest.MonkeyPatch, lockstep: bool
) -> None:
    """A full inbox makes whoever puts something into it wait, the plant itself too."""
    monkeypatch.setattr(zenoh_link, "LARGEST_BACKLOG", 5)
    link, is_over = fresh_link(), threading.Event()

    def flood(client: ZenohSession) -> None:
        publisher = client.publisher(JOINT_COMMANDS.key_expression(0))
        while not is_over.is_set():
            publisher.put(b"junk", b"")

    plant = ZenohPlantLink(link, MonotonicClock(), lockstep=lockstep)
    with tokenless_client(link) as client:
        flooding = threading.Thread(target=flood, args=[client], daemon=True)
        flooding.start()
        await_true(lambda: not plant._arrivals.is_empty())
        closing = threading.Thread(target=plant.close, daemon=True)
        closing.start()
        closing.join(HANG_S)
        is_over.set()
        flooding.join(HANG_S)
        assert not closing.is_alive()


@pytest.mark.parametrize(("side", "held_up"), [(plant_on, "wait"), (controller_on, "knock")])
def test_threads_of_a_link_have_ended_once_it_is_closed(
    monkeypatch: pytest.MonkeyPatch, side: Any, held_up: str
) -> None:
    """Python aborts a process in which a thread comes back from Zenoh while it ends."""
    quick = getattr(Inbox, held_up)

    def slow(inbox: Inbox) -> Any:
        time.sleep(0.5)
        return quick(inbox)

    monkeypatch.setattr(Inbox, held_up, slow)
    before = set(threading.enumerate())
    with side(fresh_link(), **{"lockstep": False} if side is plant_on else {}):
        ours = set(threading.enumerate()) - before
        time.sleep(0.2)  # they are held up now
    assert ours
    assert not [thread for thread in ours if thread.is_alive()]


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
            first.activate()
            plant.await_controller(HANG_S)
            assert command(first, plant, 1) is not None
        commander = gate.commander or b""
        await_true(lambda: plant.sender_has_left(commander))
        with controller_on(link) as again:  # the same controller, started again: a new session
            again.activate()
            plant.await_controller(HANG_S)
            assert command(again, plant, 2) is not None
            assert gate.commander not in (None, commander)
    assert not gate.rejections.counts


@pytest.mark.parametrize("lockstep", [True, False], ids=["lockstep", "real time"])
def test_commands_beyond_the_largest_backlog_are_counted_and_hold_up_nothing(
    lockstep: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(arrivals, "LARGEST_BACKLOG", 20)
    monkeypatch.setattr(zenoh_link, "LARGEST_BACKLOG", 20)
    link, reply = fresh_link(), layout(JOINT_COMMANDS, JOINTS).template
    with plant_on(link, lockstep=lockstep) as plant:
        with controller_on(link) as controller:
            controller.activate()
            plant.await_controller(HANG_S)
            for _ in range(50):
                controller.publish(JOINT_COMMANDS, reply)
            await_true(lambda: plant.overflow() == 30)
            assert plant.report() == {COMMANDS_RECEIVED: 20}  # recorders have no more of them
        await_true(plant.controller_has_left)  # though nobody has taken anything
        assert [arrival.sequence for arrival in plant.take_commands()] == list(range(1, 21))


def test_commands_are_stamped_when_they_come_not_when_they_are_taken() -> None:
    link, reply = fresh_link(), layout(JOINT_COMMANDS, JOINTS).template
    with plant_on(link, lockstep=False) as plant, controller_on(link) as controller:
        controller.activate()
        plant.await_controller(HANG_S)
        between: list[int] = []
        for count in (1, 2):
            controller.publish(JOINT_COMMANDS, reply)
            await_true(lambda count=count: plant._arrivals._kept.qsize() == count)
            between.append(plant._arrivals._clock.now_ns())
        first, second = plant.take_commands()
        assert first.arrival_ns <= between[0] <= second.arrival_ns <= between[1]


def test_wait_for_a_controller_that_does_not_come_ends_in_an_error_that_names_it() -> None:
    with plant_on(fresh_link()) as plant:
        with pytest.raises(PeerSilentError, match="the controller is silent") as silence:
            plant.await_controller(0.1)
        assert silence.value.peer == "controller"
        assert not plant.await_command(0.01)
        plant.await_controller(HANG_S, lambda: True)  # a stop request ends the wait


def test_error_of_the_handler_ends_the_service_and_reaches_whoever_spins() -> None:
    link = fresh_link()

    def fail(_payload: bytes, _status: bytes | None) -> None:
        raise ZeroDivisionError

    with plant_on(link) as plant, controller_on(link) as controller:
        controller.serve(fail)
        controller.activate()
        plant.await_controller(HANG_S)
        plant.send_state(state(0), status())
        with pytest.raises(ZeroDivisionError):
            controller.spin()


@contextmanager
def tokenless_client(link: LinkConfiguration) -> Iterator[ZenohSession]:
    """A client that subscribes to states, and announces nothing."""
    client = ZenohSession([], [link.plant_endpoint], low_latency=False)
    client.subscribe(JOINT_STATES.key_expression(0), lambda _: None)
    try:
        yield client
    finally:
        client.close()


@contextmanager
def recorder_on(link: LinkConfiguration, plant: ZenohPlantLink) -> Iterator[ZenohNode]:
    recorder = ZenohNode(link, Role.RECORDER, lossless=True)
    mailbox = recorder.listen_to_all(100, lossless=True)
    recorder.announce()
    try:
        plant.await_recorder(HANG_S)
        yield recorder
    finally:
        recorder.close()
        del mailbox


def test_client_without_tokens_is_the_controller_though_a_recorder_listens() -> None:
    link = fresh_link()
    with plant_on(link) as plant, recorder_on(link, plant):
        with pytest.raises(PeerSilentError):
            plant.await_controller(zenoh_link._GRACE_BESIDE_RECORDER_S + 0.5)  # nobody is there
        with tokenless_client(link):
            plant.await_controller(HANG_S)
        assert not plant.controller_has_left()  # it cannot be known


def test_command_before_the_start_is_a_sign_of_life(monkeypatch: pytest.MonkeyPatch) -> None:
    link = fresh_link()
    monkeypatch.setattr(zenoh_link, "_GRACE_BESIDE_RECORDER_S", 2 * HANG_S)
    with plant_on(link) as plant, recorder_on(link, plant), tokenless_client(link) as client:
        publisher = client.publisher(JOINT_COMMANDS.key_expression(0))
        await_true(lambda: publisher.put(b"hello", b"") or not plant._arrivals.is_empty())
        plant.await_controller(HANG_S)
