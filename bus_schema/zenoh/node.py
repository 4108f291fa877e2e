"""A Zenoh session that is a node of the ROS graph: it announces itself and knows other nodes."""

from __future__ import annotations

import logging
import secrets
import threading
import time
from collections.abc import Callable

from bus_schema.errors import PeerSilentError, ScenarioMismatchError
from bus_schema.link.agreement import Agreement
from bus_schema.link.configuration import LinkConfiguration
from bus_schema.link.interface import never
from bus_schema.messages import topics
from bus_schema.messages.topics import Role, Topic
from bus_schema.zenoh.access import (
    progress_key_expression,
    recorded_key_expression,
    scenario_key_expression,
    secure_settings,
)
from bus_schema.zenoh.bundle_mailbox import BundleMailbox
from bus_schema.zenoh.bundles import Bundler
from bus_schema.zenoh.diagnosis import SilenceWatch
from bus_schema.zenoh.outbox import FlowControl, Outbox
from bus_schema.zenoh.ros_graph import (
    Attachment,
    Entity,
    EntityKind,
    RosGraph,
    endpoint_gid,
    endpoint_token,
    graph_key_expression,
    node_name,
    node_token,
)
from bus_schema.zenoh.session import Delivery, Inbox, ZenohPublisher, ZenohSession

logger = logging.getLogger(__name__)

POLL_S = 0.05
_MOST_NAMED = 10
_SHARE_FOR_STRANGERS = 0.5
"""Share of the peers' patience for a recorder that may be forged, and has reported nothing yet."""
_MOST_SESSIONS = 1000
"""Limit on sessions that announce a scenario, as any of them may be forged."""
LOOK_S = 0.005
"""Period of checks for a peer before a run: short, as it delays every run."""
_PATIENCE_S = 0.1
"""Largest delay of a loop in virtual time by a frozen subscriber. Real-time loops never wait."""
_LEASE_S, REALTIME_LEASE_S = 60.0, 3.0
"""Short in real time: zenoh 1.10 may stop sending to a peer after a drop, until it reconnects."""


class ZenohNode:
    """A session that is a node of the ROS graph: the common base of both sides of a link.

    Args:
        link: section ``link`` of the scenario.
        role: this node's role; loops also bundle all their messages for recorders.
        lossless: wait for a slow recorder instead of losing messages.
        agreement: what others must agree on; None skips the check. A recorder that does not belong
            to its run, if that has a key, is ignored: nothing waits for it.
    """

    def __init__(
        self,
        link: LinkConfiguration,
        role: Role,
        *,
        lossless: bool,
        agreement: Agreement | None = None,
    ) -> None:
        listen, connect = _endpoints(link, role)
        is_loop = role is not Role.RECORDER
        self._run_key = "" if agreement is None else agreement.run_key
        is_marked = bool(self._run_key) and not is_loop
        # A recorder may fall behind, and must not delay the loop.
        self._session = ZenohSession(
            listen,
            connect,
            low_latency=is_loop,
            patience_s=_PATIENCE_S if lossless else 0.0,
            lease_s=_LEASE_S if lossless else REALTIME_LEASE_S,
            gossip=link.router_endpoint is not None,
            security=secure_settings(role, link.domain, link.security.keys)
            if link.security.enabled
            else None,
            identifier=self._run_key + secrets.token_hex(8) if is_marked else None,
        )
        self._link = link
        self._domain = link.domain
        self._role = role
        self._node = node_name(role)
        self._graph = RosGraph(self._session.identifier)
        self._last_entity = 0
        self._acknowledged = threading.Event()
        self._flow = self._flow_control() if lossless and is_loop else None
        self._progress: ZenohPublisher | None = None
        self._agreement = agreement
        self._strangers: set[str] = set()
        self._differences: dict[str, dict[str, list[str]]] = {}  # by role and session
        # Before all other tokens: peers that see this node then know its scenario.
        self._session.watch_tokens(scenario_key_expression(link.domain), self._on_scenario)
        if agreement is not None:
            own = (role.value, self._session.identifier, agreement.encode())
            self._session.announce(scenario_key_expression(link.domain, *own))
        self._bundler = Bundler(self._session, link.domain, role) if is_loop else None
        self.outbox = Outbox(self._bundler, self._flow)
        if self._flow is not None:
            self._session.subscribe(progress_key_expression(link.domain), self._on_progress)
        self._session.watch_tokens(graph_key_expression(link.domain), self._on_token)

    def announce(self) -> None:
        """Announce the node to the others; call it once the node is ready.

        From then on it watches for the token by which a recorder reports that it has everything.
        """
        gid = self.outbox.gid_of(topics.RUN_EVENTS)
        if gid is not None:
            key = recorded_key_expression(self._domain, gid.hex())
            self._session.watch_tokens(key, self._on_recorded)
        self._session.announce(node_token(self._domain, self._session.identifier, self._node))

    def advertise(self, topic: Topic) -> ZenohPublisher:
        """Declare a publisher, then announce it."""
        kept = topic.depth if topic.latched else 0
        publisher = self._session.publisher(topic.key_expression(self._domain), kept)
        token = self._token(EntityKind.PUBLISHER, topic)
        self.outbox.add(topic, publisher, endpoint_gid(token))
        self._session.announce(token)
        return publisher

    def inbox(self, topic: Topic, capacity: int, *, lossless: bool) -> Inbox:
        """Subscribe, and announce the subscription."""
        key = topic.key_expression(self._domain)
        inbox = self._session.inbox(key, capacity, lossless=lossless)
        self._session.announce(self._token(EntityKind.SUBSCRIBER, topic))
        return inbox

    def listen_to_all(self, most_bytes: int, *, lossless: bool) -> BundleMailbox:
        """Subscribe to everything in the domain, in one mailbox."""
        mailbox = BundleMailbox(
            self._session, self._domain, most_bytes, lossless=lossless, graph=self._graph,
            by_role=self._link.security.enabled,
        )  # fmt: skip
        for topic in topics.TOPICS:
            self._session.announce(self._token(EntityKind.SUBSCRIBER, topic))
        return mailbox

    def publish(self, topic: Topic, payload: bytes, beside: bytes = b"") -> int:
        """Send a message; return its sequence number. The bytes `beside` follow the attachment."""
        return self.outbox.send(topic, payload, beside)

    def sender_has_left(self, sender: bytes) -> bool:
        return self._graph.has_left(sender)

    def sees(self, role: Role) -> bool:
        nodes = self._graph.others(EntityKind.NODE)
        return any(self._is_of_this_run(each) for each in nodes if each.node == node_name(role))

    def watch_silence(self, role: Role) -> SilenceWatch:
        """Return a watch that reports why one of our own processes may be missing."""
        return SilenceWatch(self._link, self._role, role)

    def require_same_scenario(self, role: Role, wait_s: float = 0.0) -> None:
        """Check the scenarios that processes of a role announced; foreign processes announce none.

        One process that agrees suffices: the other announcements may be forged. A session that
        announced a scenario and nothing else is none of our processes.

        Raises:
            ScenarioMismatchError: it runs another scenario.
        """
        give_up_s = time.monotonic() + wait_s
        while not self.says_its_scenario(role) and time.monotonic() < give_up_s:
            time.sleep(LOOK_S)
        found = dict(self._differences.get(role.value, {}))
        differing = [keys for session, keys in found.items() if session in self._graph.announced]
        if differing and all(found.values()):
            raise ScenarioMismatchError(
                role, differing[-1], may_be_forged=not self._link.security.enabled
            )

    def says_its_scenario(self, role: Role) -> bool:
        """Whether each of our own processes of a role has announced its scenario.

        Zenoh delivers the tokens of a session in any order: the scenario may arrive last.
        """
        reported = self._differences.get(role.value, {}).keys()
        return self._agreement is None or self._graph.sessions_of(role) <= reported

    def acknowledge(self, gid: bytes) -> None:
        """Announce, as a recorder, that all messages of a publisher of run events are recorded."""
        own = self._session.identifier
        self._session.announce(recorded_key_expression(self._domain, gid.hex(), own))

    def tell_progress(self, gid: bytes, sequence: int) -> None:
        """Report, as a recorder, progress on a topic that paces to the sender of the topic."""
        if self._progress is None:
            self._progress = self._session.publisher(progress_key_expression(self._domain))
        acknowledged = Attachment(sequence, 0, gid).encode()
        self._progress.put(acknowledged, self._session.identifier.encode())

    def await_recorder(
        self, timeout_s: float, is_stop_requested: Callable[[], bool] = never
    ) -> None:
        give_up_s = time.monotonic() + timeout_s
        silence = self.watch_silence(Role.RECORDER)
        while not self.sees(Role.RECORDER) and not is_stop_requested():
            silence.look()
            if time.monotonic() > give_up_s:
                raise PeerSilentError(Role.RECORDER, timeout_s, "sign of life")
            time.sleep(LOOK_S)

    def await_recorded(self) -> None:
        give_up_s = time.monotonic() + self._link.reply_timeout_s
        while self.sees(Role.RECORDER) and time.monotonic() < give_up_s:
            if self._acknowledged.wait(POLL_S):
                return
            if self._bundler is not None:
                self._bundler.tell()

    def close(self) -> None:
        """Leave the bus. Messages still queued for a slow peer are lost."""
        if self._bundler is not None:
            self._bundler.send()
        self._session.close()

    def _token(self, kind: EntityKind, topic: Topic) -> str:
        self._last_entity += 1
        return endpoint_token(
            self._domain, self._session.identifier, self._node, self._last_entity, kind, topic
        )

    def _on_scenario(self, token: str, alive: bool) -> None:
        """Remember the differences, also of a peer that has left meanwhile."""
        *_, role, session, theirs = token.split("/")
        if alive and self._agreement is not None and session != self._session.identifier:
            sessions = self._differences.setdefault(role, {})
            if len(sessions) < _MOST_SESSIONS:
                sessions[session] = self._agreement.differences(theirs)

    def _on_recorded(self, token: str, _alive: bool) -> None:
        if token.rpartition("/")[2].startswith(self._run_key):
            self._acknowledged.set()

    def _on_token(self, token: str, alive: bool) -> None:
        entity = self._graph.change(token, alive)
        if entity is None or not _is_recorder(entity):
            return
        if not self._is_of_this_run(entity):
            self._name_stranger(entity.session)
        elif self._flow is not None:
            (self._flow.join if alive else self._flow.leave)(entity.session)

    def _flow_control(self) -> FlowControl:
        """Return the flow control: without a key, a recorder may be forged, and peers give up."""
        if self._run_key:
            return FlowControl()
        return FlowControl(first_patience_s=_SHARE_FOR_STRANGERS * self._link.reply_timeout_s)

    def _is_of_this_run(self, entity: Entity) -> bool:
        """Whether a node belongs to this run, as far as known: only recorders have its key."""
        return not _is_recorder(entity) or entity.session.startswith(self._run_key)

    def _name_stranger(self, session: str) -> None:
        """Warn once about a recorder that is ignored."""
        if session not in self._strangers and len(self._strangers) < _MOST_NAMED:
            self._strangers.add(session)
            logger.warning("a recorder that this run did not start is ignored: session %s", session)

    def _on_progress(self, delivery: Delivery) -> None:
        acknowledged = Attachment.decode(delivery.payload)
        if (
            self._flow is not None
            and acknowledged is not None
            and acknowledged.gid in self.outbox.gids()
        ):
            recorder = delivery.attachment.decode(errors="replace")
            self._flow.acknowledge(recorder, acknowledged.sequence)


def _is_recorder(entity: Entity) -> bool:
    return entity.kind == EntityKind.NODE and entity.node == node_name(Role.RECORDER)


def _endpoints(link: LinkConfiguration, role: Role) -> tuple[list[str], list[str]]:
    """Return the endpoints to listen on and to connect to."""
    router = [link.router_endpoint] if link.router_endpoint is not None else []
    match role:
        case Role.PLANT:
            return [link.plant_endpoint], router
        case Role.CONTROLLER:
            return [link.controller_endpoint], [link.plant_endpoint, *router]
        case Role.RECORDER:
            return [], [link.plant_endpoint, link.controller_endpoint, *router]
