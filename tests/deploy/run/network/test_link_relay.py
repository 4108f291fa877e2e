"""The relay passes on every byte, no sooner than its link says, and loses what its link loses."""

from __future__ import annotations

import asyncio
import random
import socket
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import pytest
from pymodbus.client import ModbusTcpClient, ModbusUdpClient
from pymodbus.datastore import (
    ModbusDeviceContext,
    ModbusSequentialDataBlock,
    ModbusServerContext,
)
from pymodbus.server import ModbusTcpServer, ModbusUdpServer

from bus_schema.link.channel_configuration import ChannelConfiguration
from bus_schema.link.configuration import LinkConfiguration
from deploy.run.network.link_relay import LinkRelay
from deploy.run.network.relayed_bytes import RESEND_NS
from plant_emulator.channel.opening import DOWNLINK, open_channel

DELAY_NS = 24_000_000
HANG_S = 30.0
HERE = ("127.0.0.1", 0)


@contextmanager
def relaying(target, kind=socket.SOCK_STREAM, seed=1, **channels):
    """Where a relay takes what it passes on to a target, and the relay."""
    over = threading.Event()
    with socket.socket(socket.AF_INET, kind) as listener:
        listener.bind(HERE)
        if kind == socket.SOCK_STREAM:
            listener.listen()
        relay = LinkRelay(listener, target, LinkConfiguration(**channels), seed)
        thread = threading.Thread(target=relay.run, args=(over.is_set,), daemon=True)
        thread.start()
        try:
            yield listener.getsockname(), relay
        finally:
            over.set()
            thread.join(HANG_S)


@contextmanager
def connection(**of_relay: Any) -> Iterator[tuple[socket.socket, socket.socket]]:
    """Both ends of a connection over a relay."""
    with (
        socket.create_server(HERE) as target,
        relaying(target.getsockname(), **of_relay) as (place, _),
        socket.create_connection(place, HANG_S) as near,
    ):
        far, _ = target.accept()
        far.settimeout(HANG_S)
        with far:
            yield near, far


def send_until(end: socket.socket, deadline_s: float) -> None:
    while time.monotonic() < deadline_s:
        end.sendall(b"to no receiver")
        time.sleep(0.01)


def received(end: socket.socket, count: int) -> bytes:
    received = bytearray()
    while len(received) < count and (chunk := end.recv(30_000)):
        received += chunk
    return bytes(received)


def test_bytes_come_no_sooner_than_their_delay_and_so_does_the_end() -> None:
    each_way = {"delay_ms": DELAY_NS / 1e6}
    with connection(uplink=each_way, downlink=each_way) as (near, far):
        for one, other in ((near, far), (far, near)):
            sent_ns = time.monotonic_ns()
            one.sendall(b"words")
            assert other.recv(100) == b"words"
            assert time.monotonic_ns() >= sent_ns + DELAY_NS
        near.sendall(b"last words")
        closed_ns = time.monotonic_ns()
        near.shutdown(socket.SHUT_WR)
        assert far.recv(100) == b"last words"
        assert far.recv(100) == b""
        assert time.monotonic_ns() >= closed_ns + DELAY_NS
        far.sendall(b"answer")  # the other direction is still open
        assert near.recv(100) == b"answer"


def test_every_byte_comes_through_a_receiver_that_takes_little_at_a_time() -> None:
    sent = random.Random(1).randbytes(6_000_000)
    with connection(downlink={"delay_ms": 1}) as (near, far):
        sending = threading.Thread(target=near.sendall, args=(sent,), daemon=True)
        sending.start()
        assert received(far, len(sent)) == sent


def test_sender_waits_for_a_receiver_that_does_not_read() -> None:
    with connection() as (near, _):
        near.settimeout(0.5)
        accepted = 0
        with suppress(TimeoutError):
            while accepted < 64 << 20:
                accepted += near.send(bytes(1 << 16))
        assert accepted < 32 << 20


def test_receiver_that_has_gone_ends_the_connection() -> None:
    with connection() as (near, far):
        far.close()
        assert near.recv(100) == b""
        deadline_s = time.monotonic() + HANG_S
        with pytest.raises(OSError, match=r"reset|[Bb]roken"):
            send_until(near, deadline_s)


def test_connection_to_a_closed_target_ends() -> None:
    with socket.create_server(HERE) as gone:
        target = gone.getsockname()
    with (
        relaying(target) as (place, _),
        socket.create_connection(place, HANG_S) as near,
        suppress(ConnectionResetError),
    ):
        assert near.recv(100) == b""


def test_lost_bytes_of_a_stream_come_later_in_their_order_and_once() -> None:
    lossy = {"loss": 0.4, "duplicate": 0.5, "jitter_ms": 2, "delay_ms": 2, "reorder": True}
    with connection(downlink=lossy) as (near, far):
        for number in range(20):
            near.sendall(bytes([number]))
            time.sleep(0.005)
        assert received(far, 20) == bytes(range(20))


def test_lost_chunk_with_nothing_behind_it_is_sent_again_after_a_time() -> None:
    lossy = ChannelConfiguration(loss=0.5)
    for seed in range(100):
        channel = open_channel(lossy, seed, DOWNLINK)
        if [channel.send(number, number, 5) for number in range(2)] == [False, True]:
            break
    with connection(downlink=lossy, seed=seed) as (near, far):
        sent_ns = time.monotonic_ns()
        near.sendall(b"words")
        assert far.recv(100) == b"words"
        assert time.monotonic_ns() >= sent_ns + RESEND_NS


def test_datagrams_that_are_lost_are_those_of_the_seeded_link() -> None:
    lossy, seed = {"loss": 0.2, "delay_ms": 1}, 7
    channel = open_channel(ChannelConfiguration(**lossy), seed, DOWNLINK)
    expected = [n for n in range(200) if channel.send(n, n, 100)]
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as target:
        target.bind(HERE)
        target.settimeout(HANG_S)
        with (
            relaying(target.getsockname(), socket.SOCK_DGRAM, seed, downlink=lossy) as (
                place,
                relay,
            ),
            socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as near,
        ):
            received = []
            for number in range(200):
                near.sendto(bytes([number]), place)
                if number in expected:  # one at a time, so that no buffer is full
                    received += target.recv(100)
    assert received == expected
    counts = relay.counts()
    assert counts["downlink"]["lost"] == 200 - len(expected)
    assert counts["chunks"] == len(expected)
    assert counts["lateness_us"]["max"] >= 0
    assert counts["downlink"]["delay_ms"]["p50"] == 1.0


def test_each_peer_gets_its_own_answers() -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as target:
        target.bind(HERE)
        target.settimeout(HANG_S)
        with relaying(target.getsockname(), socket.SOCK_DGRAM) as (place, _):
            peers = [socket.socket(socket.AF_INET, socket.SOCK_DGRAM) for _ in range(3)]
            for number, peer in enumerate(peers):
                peer.settimeout(HANG_S)
                peer.sendto(bytes([number]), place)
                question, address = target.recvfrom(100)
                target.sendto(question + b"!", address)
            for number, peer in enumerate(peers):
                with peer:
                    assert peer.recv(100) == bytes([number]) + b"!"


def test_trace_holds_up_datagrams(tmp_path: Path) -> None:
    trace = tmp_path / "trace.csv"
    trace.write_text("time_s,delay_ms\n0,15\n100,15\n")
    downlink = {"trace": {"file": str(trace)}}
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as target:
        target.bind(HERE)
        target.settimeout(HANG_S)
        with (
            relaying(target.getsockname(), socket.SOCK_DGRAM, downlink=downlink) as (place, _),
            socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as near,
        ):
            sent_ns = time.monotonic_ns()
            near.sendto(b"1", place)
            assert target.recv(100) == b"1"
            assert time.monotonic_ns() >= sent_ns + 15_000_000


@pytest.mark.parametrize(
    ("server", "client", "kind"),
    [
        (ModbusTcpServer, ModbusTcpClient, socket.SOCK_STREAM),
        (ModbusUdpServer, ModbusUdpClient, socket.SOCK_DGRAM),
    ],
    ids=["tcp", "udp"],
)
def test_client_and_server_of_others_meet_over_the_relay(server, client, kind) -> None:
    with socket.socket(socket.AF_INET, kind) as free:
        free.bind(HERE)
        target = free.getsockname()
    loop, ready = asyncio.new_event_loop(), threading.Event()
    registers = ModbusDeviceContext(hr=ModbusSequentialDataBlock(1, list(range(100))))

    async def serve() -> None:
        serving = server(ModbusServerContext(devices=registers, single=True), address=target)
        await serving.serve_forever(background=True)
        ready.set()

    thread = threading.Thread(target=loop.run_forever, daemon=True)
    thread.start()
    asyncio.run_coroutine_threadsafe(serve(), loop).result(HANG_S)
    each_way = {"delay_ms": 5, "jitter_ms": 1}
    with relaying(target, kind, uplink=each_way, downlink=each_way) as (place, relay):
        asking = client(place[0], port=place[1], timeout=HANG_S)
        assert asking.connect()
        for first in range(10):
            began_ns = time.monotonic_ns()
            assert asking.read_holding_registers(first, count=3).registers[0] == first
            assert time.monotonic_ns() >= began_ns + 8_000_000
        asking.close()
    loop.call_soon_threadsafe(loop.stop)
    thread.join(HANG_S)
    assert relay.counts()["uplink"]["delivered"] >= 10
