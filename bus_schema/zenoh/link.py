"""Both sides of the link over Zenoh, in rmw_zenoh's wire format.

The plant listens, and so does the controller; the controller connects to the plant, a recorder to
both. So every pair has a connection of its own, and no message takes a detour.
"""

from __future__ import annotations

import logging
import queue
import threading
import time
from collections.abc import Callable
from typing import Any

from bus_schema.errors import PeerSilentError
from bus_schema.link.agreement import Agreement
from bus_schema.link.configuration import LinkConfiguration
from bus_schema.link.interface import CommandArrival, ControllerLink, PlantLink, StateHandler, never
from bus_schema.messages import topics
from bus_schema.messages.layout import MAX_PAYLOAD_BYTES
from bus_schema.messages.run_event import COMMANDS_RECEIVED
from bus_schema.messages.topics import Role
from bus_schema.runtime.clock import Clock
from bus_schema.zenoh.node import POLL_S, ZenohNode
from bus_schema.zenoh.ros_graph import Attachment
from bus_schema.zenoh.session import Delivery

logger = logging.getLogger(__name__)

_LARGEST_BACKLOG = 10_000
_GRACE_S = 1.0
_GRACE_BESIDE_RECORDER_S = 3.0
"""A stranger beside a recorder may only be looking on, while our own controller still starts."""
_NO_ATTACHMENT = Attachment(sequence=0, source_time_ns=0, gid=b"")


class ZenohPlantLink(ZenohNode, PlantLink):
    """The plant's side.

    Args:
        link: section ``link`` of the scenario.
        clock: the plant's clock, which stamps arrivals.
        lossless: rather wait for a slow recorder than go on without it.
        agreement: what the controller must agree on.
    """

    def __init__(
        self,
        link: LinkConfiguration,
        clock: Clock,
        *,
        lossless: bool,
        agreement: Agreement | None = None,
    ) -> None:
        super().__init__(link, Role.PLANT, lossless=lossless, agreement=agreement)
        self._clock = clock
        self._arrivals: queue.SimpleQueue[CommandArrival] = queue.SimpleQueue()
        self._pending: list[CommandArrival] = []
        self._overflow = 0
        self._received = 0
        self._commander_was_seen = False
        self._states = self.advertise(topics.JOINT_STATES)
        for topic in (topics.PLANT_STATUS, topics.PLANT_TRUTH, topics.RUN_EVENTS):
            self.advertise(topic)
        if link.publish_reference:
            self.advertise(topics.JOINT_REFERENCE)
        if link.publish_clock:
            self.advertise(topics.CLOCK)
        self.subscribe(topics.JOINT_COMMANDS, self._on_command)
        self.announce()

    def await_controller(
        self, timeout_s: float, is_stop_requested: Callable[[], bool] = never
    ) -> None:
        """Wait for a publisher of commands, or for somebody who may be one without saying so.

        A client without rmw_zenoh's tokens is known by a command of any contents. Without one, it
        is taken for the controller once it has been there for a while, subscribing to states. Our
        own controller subscribes long before it is ready, and is waited for.
        """
        give_up_s = time.monotonic() + timeout_s
        stranger_since_s = None
        silence = self.watch_silence(Role.CONTROLLER)
        while not self.has_publisher(topics.JOINT_COMMANDS) and not is_stop_requested():
            silence.look()
            self.require_same_scenario(Role.CONTROLLER)  # which saw it first, and left
            now_s = time.monotonic()
            if not self._arrivals.empty():
                return
            if not self._may_have_unannounced_controller():
                stranger_since_s = None
            elif stranger_since_s is None:
                stranger_since_s = now_s
            elif now_s - stranger_since_s > self._grace_s():
                logger.info("a client that has announced nothing is taken for the controller")
                return
            if now_s > give_up_s:
                raise PeerSilentError(Role.CONTROLLER, timeout_s, "sign of life")
            time.sleep(POLL_S)
        self.require_same_scenario(Role.CONTROLLER)
        self._commander_was_seen = self.has_publisher(topics.JOINT_COMMANDS)

    def _may_have_unannounced_controller(self) -> bool:
        """A recorder subscribes to states too: beside one, a stranger has to be connected."""
        if self.sees(Role.CONTROLLER) or not self._states.has_subscribers():
            return False
        return not self.sees(Role.RECORDER) or self.hears_a_stranger()

    def _grace_s(self) -> float:
        return _GRACE_BESIDE_RECORDER_S if self.sees(Role.RECORDER) else _GRACE_S

    def send_state(self, state: bytes, status: bytes) -> None:
        self.publish(topics.PLANT_STATUS, status)
        self.publish(topics.JOINT_STATES, state)

    def await_command(self, timeout_s: float) -> bool:
        if not self._pending:
            try:
                self._pending.append(self._arrivals.get(timeout=timeout_s))
            except queue.Empty:
                return False
        return True

    def take_commands(self) -> list[CommandArrival]:
        taken, self._pending = self._pending, []
        taken.extend(self._arrivals.get_nowait() for _ in range(self._arrivals.qsize()))
        return taken

    def overflow(self) -> int:
        return self._overflow

    def may_miss_states(self) -> bool:
        """Our own controller announces itself when it is ready; of others nobody knows."""
        return not self.sees(Role.CONTROLLER)

    def report(self) -> dict[str, Any]:
        """How many commands came, whatever became of them: recorders compare it with their own."""
        return {COMMANDS_RECEIVED: self._received}

    def controller_has_left(self) -> bool:
        return self._commander_was_seen and not self.has_publisher(topics.JOINT_COMMANDS)

    def _on_command(self, delivery: Delivery) -> None:
        self._received += 1
        if self._arrivals.qsize() >= _LARGEST_BACKLOG:
            self._overflow += 1  # a flood: what comes after is no use, and memory is bounded
            return
        arrival = arrival_of(delivery.payload, delivery.attachment, self._clock.now_ns())
        self._senders.note(arrival.sender)
        self._arrivals.put(arrival)


class ZenohControllerLink(ZenohNode, ControllerLink):
    """The controller's side. States are answered on the network thread, as they arrive.

    Not before it is active, though: in a run that is under way they arrive at once.

    Args:
        link: section ``link`` of the scenario.
        lossless: rather wait for a slow recorder than go on without it.
        agreement: what the plant must agree on.

    Attributes:
        failure: the exception that ended the service of states, if any.
    """

    def __init__(
        self, link: LinkConfiguration, *, lossless: bool, agreement: Agreement | None = None
    ) -> None:
        super().__init__(link, Role.CONTROLLER, lossless=lossless, agreement=agreement)
        self._on_state: StateHandler | None = None
        self._status = b""
        self._states_seen = 0
        self._over = threading.Event()
        self.failure: Exception | None = None
        for topic in (topics.CONTROL_STATUS, topics.RUN_EVENTS):
            self.advertise(topic)
        self.subscribe(topics.PLANT_STATUS, self._on_status_delivery)
        self.subscribe(topics.JOINT_STATES, self._on_state_delivery)
        self.announce()

    def serve(self, on_state: StateHandler) -> None:
        self._on_state = on_state

    def activate(self) -> None:
        self.advertise(topics.JOINT_COMMANDS)

    def spin(self, is_stop_requested: Callable[[], bool] = never) -> None:
        """Wait for the end of the run while the network thread has the states answered."""
        seen, last_change_s, allowed_s = 0, time.monotonic(), self._link.connect_timeout_s
        plant_was_there = False
        silence = self.watch_silence(Role.PLANT)
        while not self._over.wait(POLL_S) and not is_stop_requested():
            if not self._states_seen:
                self.require_same_scenario(Role.PLANT)
            plant_is_there = self.has_publisher(topics.JOINT_STATES)
            if plant_was_there and not plant_is_there:
                return
            if not plant_is_there and not self._states_seen:
                silence.look()
            plant_was_there = plant_is_there
            if self._states_seen != seen:
                seen, last_change_s = self._states_seen, time.monotonic()
                allowed_s = self._link.reply_timeout_s + _GRACE_S
            elif time.monotonic() - last_change_s > allowed_s:
                raise PeerSilentError(Role.PLANT, allowed_s, "joint state")
        if self.failure is not None:
            raise self.failure

    def _on_status_delivery(self, delivery: Delivery) -> None:
        self._status = delivery.payload

    def _on_state_delivery(self, delivery: Delivery) -> None:
        status, self._status = self._status, b""
        is_active = self.sends_on(topics.JOINT_COMMANDS)
        if self._on_state is None or not is_active or self._over.is_set():
            return
        self._states_seen += 1
        try:
            self._on_state(delivery.payload, status or None)
        except Exception as error:  # noqa: BLE001 (raised again by spin, on the main thread)
            self.failure = error
            self._over.set()


def open_telemetry(
    link: LinkConfiguration, role: Role, *, lossless: bool, agreement: Agreement | None = None
) -> ZenohNode:
    """Telemetry of a loop whose states and torques do not go over Zenoh.

    Args:
        link: section ``link`` of the scenario.
        role: whose it is.
        lossless: rather wait for a slow recorder than go on without it.
        agreement: what the other side must agree on.

    Raises:
        SessionError: an endpoint cannot be served.
    """
    node = ZenohNode(link, role, lossless=lossless, agreement=agreement)
    for topic in (*topics.TOPICS, topics.CLOCK):
        # Commands are told of by the plant's side, since it is there that they take effect.
        sender = Role.PLANT if topic is topics.JOINT_COMMANDS else topic.sender
        if sender in (role, None):
            node.advertise(topic)
    node.announce()
    return node


def arrival_of(payload: bytes, attachment: bytes, now_ns: int) -> CommandArrival:
    """A command as the plant takes it in; a sender without an attachment has no name."""
    known = Attachment.decode(attachment) or _NO_ATTACHMENT
    return CommandArrival(payload[: MAX_PAYLOAD_BYTES + 1], known.sequence, known.gid, now_ns)
