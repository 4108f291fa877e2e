"""Where a loop's telemetry goes when states and torques travel another way."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Protocol

from bus_schema.link.configuration import LinkConfiguration
from bus_schema.link.interface import never
from bus_schema.messages import topics
from bus_schema.messages.topics import Role, Topic
from bus_schema.zenoh.node import ZenohNode


class Telemetry(Protocol):
    """What a link may ask of it."""

    def publish(self, topic: Topic, payload: bytes) -> int:
        """Send a message; its number."""
        ...

    def sees(self, role: Role) -> bool:
        """Whether one of our own processes is there."""
        ...

    def await_recorder(self, timeout_s: float, is_stop_requested: Callable[[], bool]) -> None:
        """Wait for a recorder, or until asked to stop.

        Raises:
            PeerSilentError: none came.
        """
        ...

    def await_recorded(self) -> None:
        """After an `ENDED` event: wait until a recorder, if there is one, has everything."""
        ...

    def close(self) -> None:
        """Leave."""
        ...


class ZenohTelemetry:
    """Telemetry over Zenoh.

    Args:
        link: section ``link`` of the scenario.
        role: whose it is.
        lossless: rather wait for a slow recorder than go on without it.
    """

    def __init__(self, link: LinkConfiguration, role: Role, *, lossless: bool) -> None:
        self._link = link
        self._node = ZenohNode(link, role, lossless=lossless)
        for topic in _SENT_BY[role]:
            self._node.advertise(topic)
        self._node.expect_acknowledgement()
        self._node.announce()
        self.publish = self._node.publish
        self.sees = self._node.sees
        self.close = self._node.close

    def await_recorder(
        self, timeout_s: float, is_stop_requested: Callable[[], bool] = never
    ) -> None:
        self._node.await_role(Role.RECORDER, timeout_s, is_stop_requested)

    def await_recorded(self) -> None:
        self._node.await_acknowledgement(self._link.reply_timeout_s)


# What went over CAN, the plant's side tells of in both directions: there it takes effect.
_SENT_BY: dict[Role, Sequence[Topic]] = {
    Role.PLANT: (
        topics.JOINT_STATES, topics.JOINT_COMMANDS, topics.PLANT_STATUS, topics.PLANT_TRUTH,
        topics.RUN_EVENTS,
    ),
    Role.CONTROLLER: (topics.CONTROL_STATUS, topics.RUN_EVENTS),
}  # fmt: skip
