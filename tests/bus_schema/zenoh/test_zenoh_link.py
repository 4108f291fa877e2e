"""The link over Zenoh, between its own two sides."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from contextlib import closing, contextmanager
from typing import Any

import pytest

from bus_schema.errors import PeerSilentError, ScenarioMismatchError
from bus_schema.link.agreement import Agreement
from bus_schema.link.configuration import LinkConfiguration
from bus_schema.messages.run_event import COMMANDS_RECEIVED, EventKind, RunEvent
from bus_schema.messages.topics import (
    CONTROL_STATUS,
    JOINT_COMMANDS,
    JOINT_STATES,
    PLANT_TRUTH,
    RUN_EVENTS,
    Role,
    layout,
)
from bus_schema.runtime.clock import MonotonicClock, VirtualClock
from bus_schema.zenoh import arrivals, outbox
from bus_schema.zenoh import link as zenoh_link
from bus_schema.zenoh.access import scenario_key_expression
from bus_schema.zenoh.link import ZenohPlantLink
from bus_schema.zenoh.ros_graph import EntityKind, endpoint_token, node_name, node_token
from bus_schema.zenoh.session import Delivery, Inbox, ZenohSession
from tests.bus_schema.zenoh.recorder_ear import ear_on
from tests.bus_schema.zenoh.zenoh_pair import (
    HANG_S,
    JOINTS,
    commanded_pair,
    controller_on,
    fresh_link,
    plant_on,
    spinning,
    state,
    status,
)
from tests.waiting import await_true


def test_state_and_reply_cross_the_link_with_their_bytes() -> None:
    reply = layout(JOINT_COMMANDS, JOINTS).template
    received: list[tuple[bytes, bytes | None]] = []
    with commanded_pair(lockstep=False) as (plant, controller):

        def answer(payload: bytes, status: bytes | None) -> None:
            received.append((payload, status))
            controller.publish(JOINT_COMMANDS, reply)
            controller.publish(CONTROL_STATUS, b"beside the point")

        controller.serve(answer)
        with spinning(controller):
            for tick in range(50):
                plant.send_state(state(tick), status())
                assert plant.await_command(HANG_S)
                (arrival,) = plant.take_commands()
                assert arrival.payload == reply
                assert arrival.sequence == tick + 1  # numbers begin with 1 and have no gaps
                assert len(arrival.sender) == 16
    assert received == [(state(tick), status()) for tick in range(50)]


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
def test_plant_leaves_in_the_midst_of_a_flood(monkeypatch, lockstep):
    """A full inbox makes every sender wait, the plant too."""
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
        await_true(lambda: not plant.arrivals.is_empty())
        closing = threading.Thread(target=plant.close, daemon=True)
        closing.start()
        closing.join(HANG_S)
        is_over.set()
        flooding.join(HANG_S)
        assert not closing.is_alive()


@pytest.mark.parametrize(("side", "held_up"), [(plant_on, "wait"), (controller_on, "knock")])
def test_threads_of_a_link_have_ended_once_it_is_closed(monkeypatch, side, held_up):
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


@pytest.mark.parametrize("lockstep", [True, False], ids=["lockstep", "real time"])
def test_commands_beyond_the_largest_backlog_are_counted_and_hold_up_nothing(lockstep, monkeypatch):
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
        await_true(plant.controller_has_left)  # although nothing was taken
        assert [arrival.sequence for arrival in plant.take_commands()] == list(range(1, 21))
        assert plant.report() == {COMMANDS_RECEIVED: 20}  # recorders have no more of them


def test_commands_are_stamped_when_they_come_not_when_they_are_taken() -> None:
    reply = layout(JOINT_COMMANDS, JOINTS).template
    with commanded_pair(lockstep=False) as (plant, controller):
        between: list[int] = []
        for count in (1, 2):
            controller.publish(JOINT_COMMANDS, reply)
            await_true(lambda count=count: plant.arrivals._kept.qsize() == count)
            between.append(plant.arrivals._clock.now_ns())
        first, second = plant.take_commands()
        assert first.arrival_ns <= between[0] <= second.arrival_ns <= between[1]


def test_wait_for_a_controller_that_does_not_come_ends_in_an_error_that_names_it() -> None:
    with plant_on(fresh_link()) as plant:
        with pytest.raises(PeerSilentError, match="the controller is silent") as silence:
            plant.await_controller(0.1)
        assert silence.value.peer == "controller"
        assert not plant.await_command(0.01)
        plant.await_controller(HANG_S, lambda: True)  # a stop request ends the wait


def test_controller_that_has_joined_may_take_longer_to_be_ready() -> None:
    """It compiles its kernels first, in a new installation."""
    link = fresh_link()
    with plant_on(link) as plant, controller_on(link) as controller:
        await_true(lambda: plant.sees(Role.CONTROLLER))
        ready = threading.Timer(0.5, controller.activate)
        ready.start()
        plant.await_controller(0.1)
        ready.join()
        assert not plant.controller_has_left()


def test_error_of_the_handler_ends_the_service_and_reaches_the_caller() -> None:
    def fail(_payload: bytes, _status: bytes | None) -> None:
        raise ZeroDivisionError

    with commanded_pair() as (plant, controller):
        controller.serve(fail)
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


def test_client_without_tokens_is_the_controller_though_a_recorder_listens(monkeypatch):
    link = fresh_link()
    monkeypatch.setattr(zenoh_link, "_GRACE_BESIDE_RECORDER_S", 0.5)
    with plant_on(link) as plant, ear_on(link, plant):
        with pytest.raises(PeerSilentError):
            plant.await_controller(1.0)  # there is none
        with tokenless_client(link):
            plant.await_controller(HANG_S)
        assert not plant.controller_has_left()  # it cannot be known


def test_command_before_the_start_is_a_sign_of_life(monkeypatch: pytest.MonkeyPatch) -> None:
    link = fresh_link()
    monkeypatch.setattr(zenoh_link, "_GRACE_BESIDE_RECORDER_S", 2 * HANG_S)
    with plant_on(link) as plant, ear_on(link, plant), tokenless_client(link) as client:
        publisher = client.publisher(JOINT_COMMANDS.key_expression(0))
        await_true(lambda: publisher.put(b"hello", b"") or not plant.arrivals.is_empty())
        plant.await_controller(HANG_S)


def test_scenario_token_alone_ends_no_process() -> None:
    """It counts from sessions that announce more, and not where another of that role agrees."""
    ours, theirs = Agreement({"rate_hz": "1000"}), Agreement({"rate_hz": "500"})

    def token(session: str, agreement: Agreement) -> str:
        return scenario_key_expression(0, Role.CONTROLLER, session, agreement.encode())

    clock = VirtualClock()
    with closing(ZenohPlantLink(fresh_link(), clock, lockstep=True, agreement=ours)) as plant:
        plant._on_scenario(token("stranger", theirs), True)
        plant.require_same_scenario(Role.CONTROLLER)
        plant._on_token(node_token(0, "stranger", "controller"), True)
        with pytest.raises(ScenarioMismatchError, match="rate_hz"):
            plant.require_same_scenario(Role.CONTROLLER)
        plant._on_scenario(token("ours", ours), True)
        plant.require_same_scenario(Role.CONTROLLER)


def test_scenario_that_comes_after_all_other_tokens_is_waited_for() -> None:
    """Zenoh brings the tokens of a session that was there before in any order."""
    ours, theirs = Agreement({"rate_hz": "1000"}), Agreement({"rate_hz": "500"})
    scenario = scenario_key_expression(0, Role.CONTROLLER, "other", theirs.encode())
    clock = VirtualClock()
    with closing(ZenohPlantLink(fresh_link(), clock, lockstep=True, agreement=ours)) as plant:
        node = node_name(Role.CONTROLLER)
        plant._on_token(node_token(0, "other", node), True)
        commands = endpoint_token(0, "other", node, 1, EntityKind.PUBLISHER, JOINT_COMMANDS)
        plant._on_token(commands, True)
        late = threading.Timer(0.1, plant._on_scenario, (scenario, True))
        late.start()
        with pytest.raises(ScenarioMismatchError, match="rate_hz"):
            plant.await_controller(HANG_S)
        late.join()


LONGER_THAN_A_BATCH_WAITS_S = 0.03
EVENT = RunEvent(0, Role.PLANT, EventKind.STARTED, "").encode()


@pytest.fixture
def received() -> list[Delivery]:
    """Truth that a viewer has received."""
    return []


@pytest.fixture
def plant(received: list[Delivery]) -> Iterator[ZenohPlantLink]:
    """A plant with that viewer, to which its messages come, and of which none waits."""
    link = fresh_link()
    with plant_on(link) as plant:
        viewer = ZenohSession([], [link.plant_endpoint], low_latency=False)
        viewer.subscribe(PLANT_TRUTH.key_expression(0), received.append)

        def is_received() -> bool:
            plant.publish(PLANT_TRUTH, b"a try")
            plant.publish(RUN_EVENTS, EVENT)
            return bool(received)

        await_true(is_received)
        plant.publish(PLANT_TRUTH, b"the last try")
        plant.publish(RUN_EVENTS, EVENT)
        await_true(lambda: received[-1].payload == b"the last try")
        received.clear()
        yield plant
        viewer.close()


def test_ticks_far_apart_do_not_wait_for_a_whole_batch(plant, received):
    plant.publish(PLANT_TRUTH, b"1")
    time.sleep(LONGER_THAN_A_BATCH_WAITS_S)
    plant.publish(PLANT_TRUTH, b"2")
    await_true(lambda: [message.payload for message in received] == [b"1", b"2"])


def test_an_event_takes_along_what_waits(plant, received, monkeypatch):
    monkeypatch.setattr(outbox, "_LONGEST_WAIT_NS", 1 << 62)
    plant.publish(PLANT_TRUTH, b"1")
    plant.publish(RUN_EVENTS, EVENT)
    await_true(lambda: [message.payload for message in received] == [b"1"])
