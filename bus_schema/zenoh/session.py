"""The Zenoh session: the only file that imports zenoh.

Settings are chosen for latency: one runtime thread, discovery only through a router, no batching of
urgent messages. Messages that a loop waits for go to an `Inbox`; rare ones go to callbacks on the
network thread.
"""

from __future__ import annotations

import contextlib
import json
import os
import re
import threading
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any, NamedTuple

# Zenoh reads these at import. All receivers share one thread, so a message reaches its callback
# without a thread switch. Senders from queues have another thread: a callback that fills a queue
# must not block the thread that empties it. Blocking work goes to further threads, by default up to
# fifty: on a late machine thirty start at once, and with locked memory their 2 MiB stacks add 30
# ms.
os.environ.setdefault(
    "ZENOH_RUNTIME",
    "(rx: (handover: app), net: (handover: app), acc: (handover: app),"
    " app: (worker_threads: 1, max_blocking_threads: 4),"
    " tx: (worker_threads: 1, max_blocking_threads: 4))",
)

import zenoh
import zenoh.ext

from bus_schema.errors import BusError
from bus_schema.zenoh.lingering import never_linger

# Zenoh logs, in red, unknown keys of messages for a session that is just opening or closing.
# Receivers that need these messages count the missing ones.
zenoh.init_log_from_env_or("error,zenoh::api::session=off")

MAX_MESSAGE_BYTES = 1 << 20
"""The transport itself cuts off larger messages."""
_SETTINGS: dict[str, Any] = {
    "mode": "peer",
    "connect/timeout_ms": -1,
    "connect/exit_on_failure": False,
    "connect/retry": {"period_init_ms": 20, "period_max_ms": 200, "period_increase_factor": 1.5},
    "scouting/multicast/enabled": False,
    "scouting/delay": 0,
    # Our messages are too small for it, and a process leaves its segments behind in /dev/shm.
    "transport/shared_memory/enabled": False,
    "transport/unicast/qos/enabled": False,
    "transport/link/tx/queue/size/data": 16,
    "transport/link/rx/max_message_size": MAX_MESSAGE_BYTES,
}
_CLOSE_TIMEOUT_S = 2.0
_OS_ERROR = re.compile(r"([^:\[\]]+ \(os error \d+\))")
_SOURCE = re.compile(r"\s+at\s+/\S+?:\d+\.")
"""Parts of zenoh's messages that come from the operating system and from its sources."""


def _refusal(listen: Sequence[str], connect: Sequence[str], reason: str) -> str:
    """Say why there is no session: each endpoint once, without the places in zenoh's sources."""
    ways = {"listen at": listen, "connect to": connect}
    wanted = " and ".join(f"{way} {', '.join(ends)}" for way, ends in ways.items() if ends)
    cause = _OS_ERROR.search(reason)
    shown = cause[1].strip() if cause else _SOURCE.sub("", reason).strip()
    return f"cannot {wanted or 'open a Zenoh session'}: {shown}"


class SessionError(BusError, ConnectionError):
    """A session cannot be opened; the message names the endpoints."""


class Delivery(NamedTuple):
    """A message as it came off the wire.

    Attributes:
        payload: its bytes.
        attachment: the bytes sent with it; empty if there were none.
    """

    payload: bytes
    attachment: bytes


class Inbox:
    """Deliveries on one key, for a thread that waits for them itself.

    Zenoh wakes that thread directly. A callback costs more than twice as much: the network thread
    waits for Python's lock, and then wakes the waiting thread.

    Zenoh's wait has no time-out: `knock` ends it, with a sample that stays in this session.
    """

    def __init__(self, session: zenoh.Session, key: str, capacity: int, *, lossless: bool) -> None:
        kind = zenoh.handlers.FifoChannel if lossless else zenoh.handlers.RingChannel
        self._subscriber = session.declare_subscriber(key, kind(capacity))
        self._knocker = session.declare_publisher(
            key, allowed_destination=zenoh.Locality.SESSION_LOCAL
        )
        self._mark = os.urandom(16)  # only this session knows the key of its knocks

    def wait(self) -> Delivery | None:
        """Wait for the next delivery and return it; None if a knock ended the wait."""
        try:
            delivery = _delivery(self._subscriber.recv())
        except zenoh.ZError:  # the session is closed
            return None
        return None if delivery.attachment == self._mark else delivery

    def take(self) -> Delivery | None:
        """Return the oldest delivery; None if there is none."""
        while (sample := self._subscriber.try_recv()) is not None:
            delivery = _delivery(sample)
            if delivery.attachment != self._mark:
                return delivery
        return None

    def close(self) -> None:
        """Unsubscribe: a full inbox that no thread reads would block the closing of the session."""
        _undeclare(self._subscriber)

    def knock(self) -> None:
        """End the current wait, or else the next one."""
        with contextlib.suppress(zenoh.ZError):
            self._knocker.put(b"", attachment=self._mark)


class ZenohPublisher:
    """Publisher on one key."""

    def __init__(self, publisher: zenoh.Publisher | zenoh.ext.AdvancedPublisher) -> None:
        self._publisher = publisher

    def put(self, payload: bytes, attachment: bytes) -> None:
        """Send; does nothing once the session is closed."""
        try:  # noqa: SIM105 (at every tick; a context manager takes half as long as the call)
            self._publisher.put(payload, attachment=attachment)
        except zenoh.ZError:
            pass

    def has_subscribers(self) -> bool:
        """Whether anyone on the network subscribes to the key.

        A message sent at once may still miss them: zenoh 1.10 adds routes a few milliseconds later.
        A subscriber that announces a token *after* subscribing gets everything.
        """
        return bool(self._publisher.matching_status.matching)  # type: ignore[union-attr]


class ZenohSession:
    """An open session.

    Args:
        listen: endpoints to serve.
        connect: endpoints to connect to; retried in the background until they answer.
        patience_s: how long a full queue to a slow peer may block a sender before messages for that
            peer are dropped; once, until that peer reads again.
        lease_s: silence after which others consider this session lost and reconnect.
        low_latency: use the transport without queues: least delay, but a peer that stops reading
            blocks the sender. Both ends must enable it.
        gossip: report this session's endpoints to a router, and connect to the peers that it
            reports; nodes with rmw_zenoh, which are peers by default, find each other in this way.
        security: settings that restrict peers (`access.py`); by default, all are accepted.
        identifier: up to 32 hexadecimal digits, not beginning with 0; random by default.

    Raises:
        SessionError: an endpoint cannot be served or is malformed.
    """

    def __init__(
        self,
        listen: Sequence[str],
        connect: Sequence[str],
        *,
        low_latency: bool,
        patience_s: float = 10.0,
        lease_s: float = 10.0,
        gossip: bool = False,
        security: Mapping[str, Any] | None = None,
        identifier: str | None = None,
    ) -> None:
        drop_after_us = round(1e6 * patience_s)
        settings = _SETTINGS | {
            "listen/endpoints": list(listen),
            "connect/endpoints": list(connect),
            "scouting/gossip/enabled": gossip,
            "transport/link/tx/lease": round(1e3 * lease_s),
            "transport/link/tx/queue/congestion_control/drop/wait_before_drop": drop_after_us,
            "transport/unicast/lowlatency": low_latency,
            **(security or {}),
            **({} if identifier is None else {"id": identifier}),
        }
        configuration = zenoh.Config()
        try:
            for path, value in settings.items():
                configuration.insert_json5(path, json.dumps(value))
            self._session = zenoh.open(configuration)
        except zenoh.ZError as error:
            raise SessionError(_refusal(listen, connect, str(error))) from error
        self.identifier = str(self._session.zid())
        self._kept: list[object] = []
        self._connected: set[str] = set()
        self._watch_transports()

    def publisher(self, key: str, kept: int = 0) -> ZenohPublisher:
        """Declare a publisher, which keeps so many messages for late subscribers.

        They request them as in rmw_zenoh, which calls such topics transient local.

        A message for a peer whose queue is full is dropped for that peer. Blocking could stop this
        session for good: when zenoh 1.10 gives up on a full queue, it sends a closing message that
        waits for room in that queue, on the thread that receives for all. Messages are not marked
        express: the low-latency transport sends each at once anyway, and in the queue to a recorder
        each would take a whole batch for itself.
        """
        congestion = zenoh.CongestionControl.DROP
        if not kept:
            return ZenohPublisher(
                self._session.declare_publisher(key, congestion_control=congestion)
            )
        numbers = zenoh.ext.MissDetectionConfig(heartbeat=None, sporadic_heartbeat=None)
        return ZenohPublisher(
            zenoh.ext.declare_advanced_publisher(
                self._session,
                key,
                congestion_control=congestion,
                cache=zenoh.ext.CacheConfig(kept),
                sample_miss_detection=numbers,  # the cache's, as there are no timestamps
                publisher_detection=True,
            )
        )

    def subscribe(self, key: str, on_delivery: Callable[[Delivery], None]) -> None:
        """Call `on_delivery` on the network thread for each delivery; no blocking, no errors."""
        self._kept.append(self.collect(key, lambda _, delivery: on_delivery(delivery)))

    def collect(self, key: str, on_delivery: Callable[[str, Delivery], None]) -> Callable[[], None]:
        """Call `on_delivery` with keys and deliveries until the returned function is called."""

        def handle(sample: zenoh.Sample) -> None:
            on_delivery(str(sample.key_expr), _delivery(sample))

        handler = zenoh.handlers.Callback(handle, indirect=False)
        return partial(_undeclare, self._session.declare_subscriber(key, handler))

    def inbox(self, key: str, capacity: int, *, lossless: bool) -> Inbox:
        """Subscribe with an inbox; if full, senders wait, or the oldest delivery is dropped."""
        return Inbox(self._session, key, capacity, lossless=lossless)

    def announce(self, token: str) -> None:
        """Declare a liveliness token, which lives as long as the session."""
        self._kept.append(self._session.liveliness().declare_token(token))

    def watch_tokens(self, key: str, on_change: Callable[[str, bool], None]) -> None:
        """Call `on_change` with each token and whether it is alive, existing ones first."""

        def handle(sample: zenoh.Sample) -> None:
            on_change(str(sample.key_expr), sample.kind == zenoh.SampleKind.PUT)

        handler = zenoh.handlers.Callback(handle, indirect=False)
        self._kept.append(self._session.liveliness().declare_subscriber(key, handler, history=True))

    def connected(self) -> set[str]:
        """Return the identifiers of the sessions that are connected to this one, except routers."""
        return self._connected.copy()

    def _watch_transports(self) -> None:
        """Keep track of connections by their events.

        In zenoh 1.10, `info.transports()` and the history of events panic if a low-latency
        connection closes meanwhile.
        """

        def handle(event: zenoh.TransportEvent) -> None:
            identifier = str(event.transport.zid)
            if event.kind == zenoh.SampleKind.DELETE:
                self._connected.discard(identifier)
                return
            never_linger()
            if event.transport.whatami != zenoh.WhatAmI.ROUTER:
                self._connected.add(identifier)

        handler = zenoh.handlers.Callback(handle, indirect=False)
        self._kept.append(self._session.info.declare_transport_events_listener(handler))
        self._connected.update(map(str, self._session.info.peers_zid()))
        never_linger()

    def close(self) -> None:
        """Close the session. Messages still queued for a slow peer are lost.

        It does not wait for a frozen peer, which would delay the closing for long.
        """
        closing = threading.Thread(target=self._close, daemon=True)
        closing.start()
        closing.join(_CLOSE_TIMEOUT_S)

    def _close(self) -> None:
        with contextlib.suppress(zenoh.ZError):
            self._session.close()  # type: ignore[no-untyped-call]


def _undeclare(subscriber: zenoh.Subscriber[Any]) -> None:
    with contextlib.suppress(zenoh.ZError):
        subscriber.undeclare()  # type: ignore[no-untyped-call]


def _delivery(sample: zenoh.Sample) -> Delivery:
    attachment = sample.attachment
    return Delivery(sample.payload.to_bytes(), b"" if attachment is None else attachment.to_bytes())
