"""What a recorder hears of both loops, for tests."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager

from bus_schema.link.configuration import LinkConfiguration
from bus_schema.messages import topics
from bus_schema.messages.run_event import EventKind, RunEvent
from bus_schema.messages.topics import Role, Topic
from bus_schema.zenoh.link import ZenohControllerLink, ZenohPlantLink
from bus_schema.zenoh.node import ZenohNode
from tests.bus_schema.zenoh.zenoh_pair import (
    HANG_S,
    controller_on,
    fresh_link,
    plant_on,
    state,
    status,
)
from tests.waiting import await_true

MOST_BYTES = 1 << 24
ENDED = {role: RunEvent(0, role, EventKind.ENDED, "").encode() for role in Role}


class Ear:
    """A recorder's: numbers and payloads of what it took, by topic."""

    def __init__(self, link: LinkConfiguration) -> None:
        self.link = link
        self.node = ZenohNode(link, Role.RECORDER, lossless=True)
        self.mailbox = self.node.listen_to_all(MOST_BYTES, lossless=True)
        self.node.announce()
        recorded = (*topics.TOPICS, topics.REJECTED_COMMANDS)
        self.received: dict[str, list[tuple[int, bytes]]] = {topic.name: [] for topic in recorded}

    def take_all(self) -> None:
        for messages in iter(self.mailbox.take, None):
            for topic, payload, number, _, _ in messages:
                self.received[topic.name].append((number, payload))

    def await_received(self, topic: Topic, count: int) -> None:
        self.await_true(lambda: len(self.received[topic.name]) >= count)

    def await_true(self, condition: Callable[[], bool]) -> None:
        def holds() -> bool:
            self.take_all()
            return condition()

        await_true(holds)


@contextmanager
def ear_on(link: LinkConfiguration, *loops: ZenohNode) -> Iterator[Ear]:
    """A recorder that loops know of: what they send from now on comes there."""
    ear = Ear(link)
    try:
        for loop in loops:
            loop.await_recorder(HANG_S)
        yield ear
    finally:
        ear.node.close()


@contextmanager
def recorded_pair() -> Iterator[tuple[ZenohPlantLink, ZenohControllerLink, Ear]]:
    """Both loops of a link, the controller in command, and a recorder that they know of."""
    link = fresh_link()
    with (
        plant_on(link) as plant,
        controller_on(link) as controller,
        ear_on(link, plant, controller) as ear,
    ):
        controller.activate()
        yield plant, controller, ear


def exchange(plant, controller, ticks):
    """Ticks of both loops; what a recorder is to have of them."""
    await_true(lambda: controller.sees(Role.PLANT))
    for tick in ticks:
        plant.send_state(state(tick), status())
        controller.publish(topics.JOINT_COMMANDS, state(tick))
        assert plant.await_command(HANG_S)
        (arrival,) = plant.take_commands()
        plant.note_commander(arrival.sender)
        plant.publish(topics.PLANT_TRUTH, b"truth %d" % tick)
        controller.publish(topics.CONTROL_STATUS, b"control %d" % tick)
    plant.report()  # records the last command too
    for link, role in ((plant, Role.PLANT), (controller, Role.CONTROLLER)):
        link.publish(topics.RUN_EVENTS, ENDED[role])
    numbered = [(tick + 1, tick) for tick in ticks]
    return {
        "joint_states": [(number, state(tick)) for number, tick in numbered],
        "joint_commands": [(number, state(tick)) for number, tick in numbered],
        "plant_status": [(number, status()) for number, _ in numbered],
        "plant_truth": [(number, b"truth %d" % tick) for number, tick in numbered],
        "control_status": [(number, b"control %d" % tick) for number, tick in numbered],
    }


def assert_received(ear: Ear, *sent: dict[str, list[tuple[int, bytes]]]) -> None:
    for name in sent[0]:
        assert ear.received[name] == [message for part in sent for message in part[name]], name
