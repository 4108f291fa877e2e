"""Both sides of the link over Zenoh, in rmw_zenoh's wire format.

Plant and controller listen; the controller connects to the plant, a recorder to both. So each pair
has its own connection, and no message takes a detour.
"""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable
from typing import Any

from bus_schema.errors import PeerSilentError
from bus_schema.link.agreement import Agreement
from bus_schema.link.configuration import LinkConfiguration
from bus_schema.link.interface import (
    SCENARIO_WAIT_S,
    CommandArrival,
    CommandSessions,
    ControllerLink,
    PlantLink,
    StateHandler,
    never,
)
from bus_schema.messages import topics
from bus_schema.messages.run_event import COMMANDS_RECEIVED
from bus_schema.messages.topics import Role
from bus_schema.runtime.clock import Clock
from bus_schema.zenoh.arrivals import LARGEST_BACKLOG, Arrivals, AwaitedArrivals
from bus_schema.zenoh.node import LOOK_S, POLL_S, ZenohNode
from bus_schema.zenoh.ros_graph import beside
from bus_schema.zenoh.session import Delivery

logger = logging.getLogger(__name__)

_LARGEST_STATE_BACKLOG = 1000
_COMPILES_S = 120.0
"""Further time to wait for a controller that has joined: a new installation may be compiling."""
_GRACE_S = 1.0
_GRACE_BESIDE_RECORDER_S = 3.0
"""A client beside a recorder may be a mere viewer while our own controller still starts."""


class ZenohPlantLink(ZenohNode, PlantLink, CommandSessions):
    """The plant's side.

    Args:
        link: section ``link`` of the scenario.
        clock: the plant's clock, which stamps arrivals.
        lockstep: time is virtual: the loop waits for commands, and also for a slow recorder.
        agreement: what the controller must agree on.
    """

    def __init__(
        self,
        link: LinkConfiguration,
        clock: Clock,
        *,
        lockstep: bool,
        agreement: Agreement | None = None,
    ) -> None:
        super().__init__(link, Role.PLANT, lossless=lockstep, agreement=agreement)
        self._commander_was_seen = False
        self._commanders: set[bytes] = set()
        self._taken: list[CommandArrival] = []  # not recorded yet
        self._recorded_commands = 0
        self._states = self.advertise(topics.JOINT_STATES)
        for topic in (topics.PLANT_STATUS, topics.PLANT_TRUTH, topics.RUN_EVENTS):
            self.advertise(topic)
        if link.publish_reference:
            self.advertise(topics.JOINT_REFERENCE)
        if link.publish_clock:
            self.advertise(topics.CLOCK)
        inbox = self.inbox(topics.JOINT_COMMANDS, LARGEST_BACKLOG, lossless=True)
        arrivals = AwaitedArrivals if lockstep else Arrivals
        self.arrivals = arrivals(inbox, clock, self._graph.note_command)
        self.announce()

    @property
    def sessions(self) -> CommandSessions:
        return self

    def await_controller(
        self, timeout_s: float, is_stop_requested: Callable[[], bool] = never
    ) -> None:
        """Wait for a publisher of commands, or for a client that may be one unannounced.

        A client without rmw_zenoh's tokens counts as the controller once it sends any command, or
        once it has subscribed to states for a while. Our own controller subscribes long before it
        is ready, and must announce itself.
        """
        give_up_s = time.monotonic() + timeout_s
        stranger_since_s = None
        silence = self.watch_silence(Role.CONTROLLER)
        while not self._graph.has_publisher(topics.JOINT_COMMANDS) and not is_stop_requested():
            silence.look()
            self.require_same_scenario(Role.CONTROLLER)  # noted even if that peer has left
            now_s = time.monotonic()
            if not self.arrivals.is_empty():
                return
            if not self._may_have_unannounced_controller():
                stranger_since_s = None
            elif stranger_since_s is None:
                stranger_since_s = now_s
            elif now_s - stranger_since_s > self._grace_s():
                logger.info("a client that has announced nothing is taken for the controller")
                return
            if now_s > give_up_s + (_COMPILES_S if self.sees(Role.CONTROLLER) else 0.0):
                raise PeerSilentError(Role.CONTROLLER, timeout_s, "sign of life")
            time.sleep(LOOK_S)
        self.require_same_scenario(Role.CONTROLLER, SCENARIO_WAIT_S)
        self._commander_was_seen = self._graph.has_publisher(topics.JOINT_COMMANDS)

    def _may_have_unannounced_controller(self) -> bool:
        """Whether a client may be a controller: a recorder subscribes too, but announces itself."""
        if self.sees(Role.CONTROLLER) or not self._states.has_subscribers():
            return False
        return not self.sees(Role.RECORDER) or self._has_unknown_session()

    def _has_unknown_session(self) -> bool:
        """Whether a session is connected that has announced nothing; routers do not count."""
        return not self._graph.knows_all(self._session.connected())

    def _grace_s(self) -> float:
        return _GRACE_BESIDE_RECORDER_S if self.sees(Role.RECORDER) else _GRACE_S

    def send_state(self, state: bytes, status: bytes) -> None:
        """Send both in one message, which the controller waits for, and the status alone too."""
        self.publish(topics.JOINT_STATES, state, status)
        self.publish(topics.PLANT_STATUS, status)

    def await_command(self, timeout_s: float) -> bool:
        return self.arrivals.await_one(timeout_s)

    def take_commands(self) -> list[CommandArrival]:
        """Return the commands that arrived, and record those returned before, now checked."""
        if self._commanders or len(self._taken) > LARGEST_BACKLOG:
            self._record_taken()
        self._taken += (taken := self.arrivals.take())
        return taken

    def note_commander(self, sender: bytes) -> None:
        self._commanders.add(sender)

    def overflow(self) -> int:
        return self.arrivals.overflow

    def may_miss_states(self) -> bool:
        """Whether the controller has not announced itself: our own does so when it is ready."""
        return not self.sees(Role.CONTROLLER)

    def report(self) -> dict[str, Any]:
        """Record the last commands; return their number, which recorders compare with their own.

        Commands dropped because too many waited are counted separately.
        """
        self.take_commands()
        self._record_taken()
        return {COMMANDS_RECEIVED: self._recorded_commands}

    def controller_has_left(self) -> bool:
        return self._commander_was_seen and not self._graph.has_publisher(topics.JOINT_COMMANDS)

    def close(self) -> None:
        self.arrivals.close()
        super().close()

    def _record_taken(self) -> None:
        """Pass checked commands on to recorders; while there is no commander, all as commands."""
        taken, self._taken = self._taken, []
        self._recorded_commands += len(taken)
        for arrival in taken:
            is_valid = not self._commanders or arrival.sender in self._commanders
            topic = topics.JOINT_COMMANDS if is_valid else topics.REJECTED_COMMANDS
            if self._bundler is not None:
                self._bundler.add(topic.name.encode(), arrival.attachment, arrival.payload)


class ZenohControllerLink(ZenohNode, ControllerLink):
    """The controller's side. The thread that calls `spin` waits for states, and answers them.

    It answers none before `activate`: in a run that is under way, states arrive at once.

    Args:
        link: section ``link`` of the scenario.
        lossless: wait for a slow recorder instead of losing messages.
        agreement: what the plant must agree on.
    """

    def __init__(
        self, link: LinkConfiguration, *, lossless: bool, agreement: Agreement | None = None
    ) -> None:
        super().__init__(link, Role.CONTROLLER, lossless=lossless, agreement=agreement)
        self._on_state: StateHandler | None = None
        for topic in (topics.CONTROL_STATUS, topics.RUN_EVENTS):
            self.advertise(topic)
        self._states = self.inbox(topics.JOINT_STATES, _LARGEST_STATE_BACKLOG, lossless=False)
        self._closed = threading.Event()
        self._knocking = threading.Thread(target=self._wake_now_and_then, daemon=True)
        self._knocking.start()
        self.announce()

    def serve(self, on_state: StateHandler) -> None:
        self._on_state = on_state

    def activate(self) -> None:
        while self._states.take() is not None:
            pass  # it arrived too early
        self.advertise(topics.JOINT_COMMANDS)

    def spin(self, is_stop_requested: Callable[[], bool] = never) -> None:
        has_answered, last_s, allowed_s = False, time.monotonic(), self._link.connect_timeout_s
        silence = self.watch_silence(Role.PLANT)
        while not is_stop_requested():
            delivery = self._states.wait()
            if delivery is not None:
                self._answer(delivery)
                has_answered, last_s = True, time.monotonic()
                allowed_s = self._link.reply_timeout_s + _GRACE_S
                continue
            if not has_answered:
                self.require_same_scenario(Role.PLANT)
            if self._graph.publishers_have_left(topics.JOINT_STATES):
                return
            if not self._graph.has_publisher(topics.JOINT_STATES) and not has_answered:
                silence.look()
            if time.monotonic() - last_s > allowed_s:
                raise PeerSilentError(Role.PLANT, allowed_s, "joint state")

    def close(self) -> None:
        self._closed.set()
        self._knocking.join()  # if it leaves Zenoh while Python exits, the process aborts
        super().close()

    def _answer(self, delivery: Delivery) -> None:
        if self._on_state is not None:
            self._on_state(delivery.payload, beside(delivery.attachment))

    def _wake_now_and_then(self) -> None:
        """Wake the waiting thread now and then."""
        while not self._closed.wait(POLL_S):
            self._states.knock()


def open_telemetry(
    link: LinkConfiguration, role: Role, *, lossless: bool, agreement: Agreement | None = None
) -> ZenohNode:
    """Return the telemetry of a loop whose states and torques do not go over Zenoh.

    Args:
        link: section ``link`` of the scenario.
        role: the loop's role.
        lossless: wait for a slow recorder instead of losing messages.
        agreement: what the other side must agree on.

    Raises:
        SessionError: an endpoint cannot be served.
    """
    node = ZenohNode(link, role, lossless=lossless, agreement=agreement)
    for topic in (*topics.TOPICS, topics.CLOCK):
        # The plant's side bundles commands, as they take effect there.
        sender = Role.PLANT if topic is topics.JOINT_COMMANDS else topic.sender
        if sender in (role, None):
            node.advertise(topic)
    node.announce()
    return node
