"""The probe recovers delays, losses and clocks of a link that is known."""

from __future__ import annotations

import socket
import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest

from bus_schema.link.configuration import LinkConfiguration
from deploy.measure.link_probe import ProbeTimes, clock_offset_ns, evaluate, probe
from deploy.measure.probe_frames import LEAST_BYTES, FrameStream, ProbeFrame, ProbeServer
from deploy.measure.zenoh_socket import zenoh_client, zenoh_server
from deploy.run.network.link_relay import LinkRelay
from deploy.run.network.links import free_ports
from plant_emulator.channel.trace_file import read_trace

MS = 1_000_000
HANG_S = 30.0
HERE = ("127.0.0.1", 0)
KINDS = {"udp": socket.SOCK_DGRAM, "tcp": socket.SOCK_STREAM}


@contextmanager
def in_thread(run) -> Iterator[None]:
    over = threading.Event()
    thread = threading.Thread(target=run, args=(over.is_set,), daemon=True)
    thread.start()
    try:
        yield
    finally:
        over.set()
        thread.join(HANG_S)


@contextmanager
def server() -> Iterator[int]:
    """Port of a server."""
    with socket.create_server(HERE) as listener, socket.socket(type=socket.SOCK_DGRAM) as datagrams:
        datagrams.bind(listener.getsockname())
        with in_thread(ProbeServer(datagrams, listener).run):
            yield listener.getsockname()[1]


@pytest.mark.parametrize("protocol", KINDS)
def test_known_link_is_recovered(protocol: str) -> None:
    link = LinkConfiguration(
        downlink={"delay_ms": 3, "loss": 0.05}, uplink={"delay_ms": 7, "loss": 0.1}
    )
    with server() as port, socket.socket(type=KINDS[protocol]) as listener:
        listener.bind(HERE)
        if protocol == "tcp":
            listener.listen()
        relay = LinkRelay(listener, ("127.0.0.1", port), link, seed=1)
        with in_thread(relay.run), socket.socket(type=KINDS[protocol]) as way:
            way.connect(listener.getsockname())
            times = probe(way, 200.0, 150, 1.5, lambda: False, lambda *_: None)
    measured, reported = evaluate(times), relay.counts()
    assert times.has_one_clock
    assert measured.uncertainty_ms == 0.0
    assert np.nanmin(measured.there.delays_ms) >= 3.0
    assert np.nanmin(measured.back.delays_ms) >= 7.0
    assert len(measured.there.sent_s) == 300
    if protocol == "udp":
        assert measured.there.lost == reported["downlink"]["lost"] > 0
        assert measured.back.lost == reported["uplink"]["lost"] > 0
    else:
        assert measured.there.lost == measured.back.lost == 0
        assert np.nanmax(measured.there.delays_ms) >= 10.0  # what was sent again


def test_delay_over_zenoh_is_recovered() -> None:
    link = LinkConfiguration(downlink={"delay_ms": 3}, uplink={"delay_ms": 7})
    [served] = free_ports(1)
    with zenoh_server(served) as answering, socket.create_server(HERE) as listener:
        relay = LinkRelay(listener, ("127.0.0.1", served), link, seed=1)
        with (
            in_thread(ProbeServer(answering).run),
            in_thread(relay.run),
            zenoh_client("127.0.0.1", listener.getsockname()[1], HANG_S) as way,
        ):
            times = probe(way, 200.0, 150, 1.5, lambda: False, lambda *_: None)
    measured = evaluate(times)
    assert times.has_one_clock
    for delays, injected_ms in ((measured.there, 3.0), (measured.back, 7.0)):
        assert delays.lost == 0
        assert len(delays.sent_s) == 300
        assert np.nanmin(delays.delays_ms) >= injected_ms
    assert np.nanmin(measured.there.delays_ms) < np.nanmin(measured.back.delays_ms)
    assert measured.reordered == (0, 0)


def times(offset_ms, drift_ppm, seconds=60.0, rate_hz=500.0):
    """Those of a link with queues and a clock that is ahead; and its delays there, ms."""
    random = np.random.default_rng(3)
    count = round(seconds * rate_hz)
    sent = 10**15 + np.arange(count) * round(1e9 / rate_hz)
    there, back = (2 + random.exponential(3.0, (2, count))) * MS
    ahead = offset_ms * MS + (sent - sent[0]) * drift_ppm * 1e-6
    received = sent + there + ahead
    returned = sent + there + back + 0.1 * MS
    columns = [each.astype(np.int64) for each in (sent, received, received + 0.1 * MS, returned)]
    return ProbeTimes(*columns, has_one_clock=False), there / MS


@pytest.mark.parametrize("offset_ms", [0.0, 5.0, -1e6])
@pytest.mark.parametrize("drift_ppm", [0.0, 40.0, -100.0])
def test_clock_of_the_other_side_is_found(offset_ms: float, drift_ppm: float) -> None:
    given, there_ms = times(offset_ms, drift_ppm)
    found = evaluate(given)
    assert found.offset_ms == pytest.approx(offset_ms, abs=0.1)
    assert found.drift_ppm == pytest.approx(drift_ppm, abs=3.0)
    assert 2.0 <= found.uncertainty_ms <= 2.2  # the least delay there and back may all be there
    np.testing.assert_allclose(found.there.delays_ms, there_ms, atol=0.15)


def test_uncertainty_covers_a_link_that_is_not_symmetric() -> None:
    elapsed_s = np.arange(0.0, 30.0, 0.01)
    flat = np.ones(len(elapsed_s), dtype=np.int64)
    line, uncertainty_ns = clock_offset_ns(elapsed_s, 8 * MS * flat, 2 * MS * flat)
    assert line[0] == pytest.approx(3 * MS)  # the clocks agree, and nothing can say so
    assert uncertainty_ns == pytest.approx(5 * MS)


def test_losses_are_counted_by_direction_and_order_is_kept() -> None:
    given, _ = times(0.0, 0.0, seconds=1.0, rate_hz=100.0)
    given.received_ns[[10, 20]] = 0  # lost there
    given.returned_ns[[10, 20, 30, 31, 32]] = 0  # the others on the way back
    given.received_ns[40] = given.received_ns[42] + 1
    given.received_ns[50:60] = given.returned_ns[50:60] = 0  # longer than answers tell of
    found = evaluate(given)
    assert found.there.lost == 2 + 7
    assert found.back.lost == 3 + 3
    assert found.reordered[0] >= 1


def test_answers_have_the_times_at_which_they_were_sent() -> None:
    given, there_ms = times(5.0, 40.0, seconds=10.0)
    given.returned_ns[::50] = 0  # their arrival there is known from later answers
    found = evaluate(given)
    answered_s = np.arange(len(there_ms)) / 500.0 + (there_ms + 0.1) / 1e3
    answered_s[::50] -= 1e-4
    np.testing.assert_allclose(found.back.sent_s, np.sort(answered_s), atol=2e-4)


def test_too_few_answers_are_refused() -> None:
    given, _ = times(0.0, 0.0, seconds=1.0, rate_hz=100.0)
    given.returned_ns[5:] = 0
    with pytest.raises(ValueError, match="5 of 100 frames came back"):
        evaluate(given)


def test_what_is_no_frame_is_not_answered() -> None:
    frame = ProbeFrame(LEAST_BYTES, 1, 2, 3, 4)
    assert ProbeFrame.decode(frame.encode()) == frame
    assert ProbeFrame.decode(b"hello") is None
    assert ProbeFrame.decode(b"x" * 200) is None
    with pytest.raises(ValueError, match="not frames of a link probe"):
        list(FrameStream().cut(b"GET / HTTP/1.1\r\n" * 20))
    pieces, stream = frame.encode() * 3, FrameStream()
    assert [f for at in range(0, len(pieces), 50) for f in stream.cut(pieces[at : at + 50])] == [
        frame
    ] * 3
    with server() as port, socket.socket(type=socket.SOCK_DGRAM) as way:
        way.connect(("127.0.0.1", port))
        way.settimeout(HANG_S)
        way.send(b"x" * 200)
        way.send(frame.encode()[:-1])
        way.send(frame.encode())
        answer = ProbeFrame.decode(way.recv(1000))
    assert answer is not None
    assert answer.number == 2


def test_command_writes_traces_and_says_how_to_use_them(tmp_path: Path) -> None:
    with server() as port:
        command = [sys.executable, "-m", "deploy.cli", "link", "127.0.0.1", "--port", str(port)]
        ran = subprocess.run(
            [*command, "--duration", "0.5", "--rate", "200"],
            cwd=tmp_path, capture_output=True, text=True, timeout=4 * HANG_S, check=False,
        )  # fmt: skip
    assert ran.returncode == 0, ran.stderr
    assert "downlink: {trace: {file: link_downlink.csv}}" in ran.stdout
    assert len(read_trace(tmp_path / "link_uplink.csv").delays_ns) == 100


def test_command_serves_and_measures_over_zenoh(tmp_path: Path) -> None:
    [port] = free_ports(1)
    command = [sys.executable, "-m", "deploy.cli", "link", "--zenoh", "--port", str(port)]
    with subprocess.Popen([*command, "--serve"], stdout=subprocess.PIPE, text=True) as serving:
        try:
            assert serving.stdout is not None
            assert serving.stdout.readline() == f"answering on port {port}, Zenoh, until stopped\n"
            ran = subprocess.run(
                [*command, "127.0.0.1", "--duration", "0.5", "--rate", "200"],
                cwd=tmp_path, capture_output=True, text=True, timeout=4 * HANG_S, check=False,
            )  # fmt: skip
        finally:
            serving.terminate()
    assert ran.returncode == 0, ran.stderr
    assert "downlink: 100 messages" in ran.stdout
    assert serving.returncode == 0
