"""A recorder receives what it missed later: in order, and once."""

from __future__ import annotations

import socket
import threading
from collections import Counter
from collections.abc import Iterator
from contextlib import closing, contextmanager, suppress
from itertools import count

import pytest

from bus_schema.link.configuration import LinkConfiguration
from bus_schema.messages import topics
from bus_schema.messages.topics import Role
from bus_schema.zenoh import bundles
from bus_schema.zenoh.access import missed_key_expression
from bus_schema.zenoh.bundle_order import _AGAIN_S, _MOST_ASKED, _MOST_WAITING, BundleOrder
from bus_schema.zenoh.bundles import MOST_AT_ONCE, Bundler, Span
from bus_schema.zenoh.link import ZenohControllerLink
from bus_schema.zenoh.session import ZenohSession
from tests.bus_schema.zenoh.recorder_ear import Ear, assert_received, ear_on, exchange
from tests.bus_schema.zenoh.zenoh_pair import HANG_S, controller_on, fresh_link, plant_on
from tests.waiting import await_true

SENDER = b"s" * 16


class Wire:
    """Takes one connection at a time to an endpoint, as long as it is whole."""

    def __init__(self, endpoint: str) -> None:
        self._there = endpoint
        self._listener = socket.create_server(("127.0.0.1", 0))
        self.endpoint = f"tcp/127.0.0.1:{self._listener.getsockname()[1]}"
        self._is_whole = threading.Event()
        self._is_whole.set()
        self._ends: list[socket.socket] = []
        self._accepting = threading.Thread(target=self._accept, daemon=True)
        self._accepting.start()

    def cut(self) -> None:
        self._is_whole.clear()
        for end in self._ends:
            _shut(end)

    def mend(self) -> None:
        self._is_whole.set()

    def close(self) -> None:
        self.cut()
        _shut(self._listener)
        self._listener.close()

    def _accept(self) -> None:
        while True:
            try:
                here, _ = self._listener.accept()
            except OSError:
                return
            if not self._is_whole.is_set():
                here.close()
                continue
            host, _, port = self._there.removeprefix("tcp/").rpartition(":")
            there = socket.create_connection((host, int(port)))
            self._ends += here, there
            for source, sink in ((here, there), (there, here)):
                threading.Thread(target=_carry, args=(source, sink), daemon=True).start()


def _carry(source: socket.socket, sink: socket.socket) -> None:
    with suppress(OSError):
        while data := source.recv(1 << 16):
            sink.sendall(data)
    _shut(sink)


def _shut(end: socket.socket) -> None:
    with suppress(OSError):
        end.shutdown(socket.SHUT_RDWR)


@contextmanager
def wire_to_controller(link: LinkConfiguration) -> Iterator[tuple[Wire, LinkConfiguration]]:
    """A wire, and the link of a client that connects to the controller over it."""
    wire = Wire(link.controller_endpoint)
    try:
        yield wire, link.model_copy(update={"controller_endpoint": wire.endpoint})
    finally:
        wire.close()


def await_loss(controller: ZenohControllerLink, ear: Ear) -> None:
    """Until both know that they are apart."""
    await_true(lambda: not controller.sees(Role.RECORDER))
    ear.await_true(lambda: not ear.node.sees(Role.CONTROLLER))


def test_recorder_first_receives_what_was_sent_before_it_came() -> None:
    link = fresh_link()
    with plant_on(link) as plant, controller_on(link) as controller:
        controller.activate()
        before = exchange(plant, controller, range(50))
        with ear_on(link, plant, controller) as ear:
            after = exchange(plant, controller, range(50, 100))
            ear.await_received(topics.RUN_EVENTS, 4)
            assert_received(ear, before, after)


def test_messages_from_a_lost_connection_arrive_in_order_later() -> None:
    link = fresh_link()
    with (
        plant_on(link) as plant,
        controller_on(link) as controller,
        wire_to_controller(link) as (wire, over_wire),
        ear_on(over_wire, plant, controller) as ear,
    ):
        controller.activate()
        sent = [exchange(plant, controller, range(50))]
        wire.cut()
        await_loss(controller, ear)
        sent.append(exchange(plant, controller, range(50, 100)))
        wire.mend()
        controller.await_recorder(HANG_S)
        sent.append(exchange(plant, controller, range(100, 150)))
        ear.await_received(topics.RUN_EVENTS, 6)
        ear.await_received(topics.CONTROL_STATUS, 150)
        assert_received(ear, *sent)


@pytest.fixture
def rejected() -> Counter[str]:
    return Counter()


@pytest.fixture
def order(rejected: Counter[str]) -> BundleOrder:
    return BundleOrder(SENDER, rejected)


def numbered(*numbers: int) -> list[bytes]:
    return [b"%d" % number for number in numbers]


def taken_in(order: BundleOrder, *numbers: int, first: int = 1) -> list[bytes]:
    """What comes out as bundles of these numbers come in."""
    return [
        bundle
        for number in numbers
        for bundle in order.take_in(Span(first, number, SENDER), b"%d" % number)
    ]


def test_bundles_come_out_in_order_and_once(order: BundleOrder) -> None:
    assert taken_in(order, 1, 2, 2, 1) == numbered(1, 2)
    assert taken_in(order, 6, 4, 6) == []
    assert order.missed(0.0) == Span(3, 3, SENDER)
    assert taken_in(order, 3) == numbered(3, 4)
    assert order.missed(0.0) == Span(5, 5, SENDER)
    assert taken_in(order, 5, 7) == numbered(5, 6, 7)
    assert order.missed(HANG_S) is None
    assert order.rest() == []


def test_what_is_on_its_way_is_not_asked_for_again(order: BundleOrder) -> None:
    assert taken_in(order, 100) == []
    assert order.missed(0.0) == Span(1, MOST_AT_ONCE, SENDER)
    times_s = count(0.0, 0.9 * _AGAIN_S)  # between two that come over a slow connection
    for number in range(1, MOST_AT_ONCE):
        assert taken_in(order, number) == numbered(number)
        assert order.missed(next(times_s)) is None
    assert taken_in(order, MOST_AT_ONCE) == numbered(MOST_AT_ONCE)
    assert order.missed(next(times_s)) == Span(MOST_AT_ONCE + 1, 2 * MOST_AT_ONCE, SENDER)


def test_what_does_not_come_is_asked_for_again_after_twice_as_long(order: BundleOrder) -> None:
    assert taken_in(order, 2) == []
    asked_ms = [ms for ms in range(0, 1000, 30) if order.missed(1e-3 * ms) == Span(1, 1, SENDER)]
    assert asked_ms == [0, 210, 630]


FORGED = 2**62


def test_forged_number_is_left_out_and_bars_no_genuine_bundle(order, rejected):
    assert taken_in(order, 1, 2) == numbered(1, 2)
    assert taken_in(order, FORGED, first=FORGED) == []
    assert order.missed(0.0) is None
    assert taken_in(order, 3) == numbered(3)
    assert rejected == {"forged_number": 1}


def test_bundles_follow_a_forged_one_that_came_before_all_of_them(order, rejected):
    assert taken_in(order, FORGED, first=FORGED) == numbered(FORGED)
    assert taken_in(order, 1, 2) == numbered(1, 2)
    assert rejected == {"forged_number": 1}


def test_second_bundle_of_a_number_is_left_out_and_counted_where_it_is_another(order, rejected):
    assert order.take_in(Span(1, 3, SENDER), b"forged ahead") == []
    assert taken_in(order, 1, 1, 2) == [*numbered(1, 2), b"forged ahead"]
    assert taken_in(order, 3, 4) == numbered(4)
    assert order.take_in(Span(1, 2, SENDER), b"forged behind") == []
    assert rejected == {"altered_bundle": 2}


def test_few_large_bundles_wait_for_one_that_never_comes(order: BundleOrder) -> None:
    large = bytes(1 << 20)
    come = [len(order.take_in(Span(1, number, SENDER), large)) for number in range(2, 30)]
    assert sum(come) >= 17


def test_span_of_more_than_a_sender_keeps_is_none() -> None:
    assert Span.decode(Span(1, 512, SENDER).encode()) == Span(1, 512, SENDER)
    assert Span.decode(Span(1, 513, SENDER).encode()) is None


def test_flood_of_requests_is_answered_in_part(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(bundles.time, "monotonic", lambda: 10.0)
    with closing(ZenohSession([], [], low_latency=False)) as session:
        bundler = Bundler(session, 0, Role.PLANT)
        assert sum(bundler._may_answer() for _ in range(500)) == 50


def test_bundles_that_the_sender_has_dropped_are_not_awaited(order: BundleOrder) -> None:
    assert taken_in(order, 3, 9) == []
    assert taken_in(order, 10, first=5) == numbered(3)
    assert order.missed(0.0) == Span(5, 8, SENDER)


def test_last_bundle_is_missed_once_it_is_announced(order: BundleOrder) -> None:
    assert taken_in(order, 1) == numbered(1)
    assert order.take_in(Span(1, 3, SENDER), b"") == []
    assert order.missed(0.0) == Span(2, 3, SENDER)
    assert taken_in(order, 2, 3) == numbered(2, 3)


def test_what_is_asked_for_in_vain_is_waited_for_no_longer(order: BundleOrder) -> None:
    assert taken_in(order, 2, 4) == []
    for time in range(_MOST_ASKED):
        assert order.overdue() == []
        assert order.missed(HANG_S * time) == Span(1, 1, SENDER)
    assert order.overdue() == numbered(2)
    assert order.overdue() == []
    assert order.missed(HANG_S * _MOST_ASKED) == Span(3, 3, SENDER)


def test_no_more_than_so_many_wait_for_one_that_never_comes(order: BundleOrder) -> None:
    waiting = range(2, _MOST_WAITING + 2)
    assert taken_in(order, *waiting) == []
    assert taken_in(order, 1000) == numbered(*waiting)
    assert order.rest() == numbered(1000)


def test_a_loop_keeps_its_newest_bundles_and_sends_some_of_them_at_once(monkeypatch):
    monkeypatch.setattr(bundles, "_KEPT_BYTES", 3500)
    monkeypatch.setattr(bundles, "MOST_AT_ONCE", 2)
    session, again = ZenohSession([], [], low_latency=False), []
    bundler = Bundler(session, 0, Role.PLANT)
    for number in range(5):
        bundler.add(b"plant_truth", b"", b"%d" % number + bytes(1000))
        bundler.send()
    session.subscribe("funnel_hil/**", lambda delivery: again.append(delivery.attachment))
    ask = session.publisher(missed_key_expression(0))
    for nonsense in (b"", bytes(32), Span(1, 5, SENDER).encode(), Span(9, 12, SENDER).encode()):
        ask.put(nonsense, b"")
    ask.put(Span(1, 5, bundler._sender).encode(), b"")
    bundler.tell()
    reported = [Span.decode(attachment) for attachment in again if attachment]
    session.close()
    assert reported == [Span(3, number, bundler._sender) for number in (3, 4, 5)]
