"""A bus within the process: receivers of frames, and threads of turns."""

from __future__ import annotations

import threading
from collections.abc import Iterator

from bus_schema.can.exchange import ExchangeNode, FrameExchange
from bus_schema.can.frame import CanFrame

PING, PONG = CanFrame(0x80), CanFrame(0x181, b"\1")
LONG_S = 60.0


def test_all_other_nodes_receive_a_batch_in_order() -> None:
    exchange = FrameExchange()
    sender, *others = (exchange.join() for _ in range(3))
    sender.send_all((PING, PONG))
    sender.send(PING)
    for other in others:
        assert [other.receive(0.0) for _ in range(4)] == [PING, PONG, PING, None]
    assert sender.receive(0.0) is None
    others[0].close()
    sender.send(PING)
    assert [other.receive(0.0) for other in others] == [None, PING]


def pings(node: ExchangeNode, count: int, threads: list[int]) -> Iterator[None]:
    """Ask and read the answer, `count` times; note on which thread."""
    for _ in range(count):
        node.send(PING)
        yield
        threads.append(threading.get_ident())
        assert node.receive(0.0) == PONG


def leave(node: ExchangeNode, turns: Iterator[None], raised: list[Exception]) -> None:
    try:
        node.leave_turns(turns)
    except Exception as error:  # noqa: BLE001 (what the test is about)
        raised.append(error)


def test_turns_run_in_the_thread_that_waits_for_their_frames() -> None:
    exchange = FrameExchange()
    guest, host = exchange.join(), exchange.join()
    threads: list[int] = []
    raised: list[Exception] = []
    owner = threading.Thread(target=leave, args=(guest, pings(guest, 100, threads), raised))
    owner.start()
    for _ in range(100):
        assert host.receive(LONG_S) == PING
        host.send(PONG)
    assert host.receive(0.1) is None
    owner.join(LONG_S)
    assert not owner.is_alive()
    assert not raised
    assert set(threads) == {threading.get_ident()}


def test_owner_makes_the_turns_once_the_others_are_gone() -> None:
    exchange = FrameExchange()
    guest, host = exchange.join(), exchange.join()
    threads: list[int] = []

    def turns() -> Iterator[None]:
        for _ in range(3):
            threads.append(threading.get_ident())
            yield

    owner = threading.Thread(target=leave, args=(guest, turns(), []))
    owner.start()
    host.close()
    owner.join(LONG_S)
    assert not owner.is_alive()
    assert set(threads) == {owner.ident}


def test_error_of_a_turn_reaches_its_owner_and_not_its_host() -> None:
    exchange = FrameExchange()
    guest, host = exchange.join(), exchange.join()
    raised: list[Exception] = []

    def turns() -> Iterator[None]:
        guest.send(PING)
        yield
        raise ValueError("no answer")

    owner = threading.Thread(target=leave, args=(guest, turns(), raised))
    owner.start()
    assert host.receive(LONG_S) == PING
    assert host.receive(0.1) is None
    owner.join(LONG_S)
    assert [str(error) for error in raised] == ["no answer"]
