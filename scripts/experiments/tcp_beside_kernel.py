"""Compares the emulated TCP with the kernel's, whose packets pass through the same lossy channel.

`python -m scripts.experiments.tcp_beside_kernel` prints a table of delays. A TUN device in a
network namespace of its own carries all IP packets of two sockets; this process loses and delays
them as ``link`` says, with the project's channel of datagrams. Needs ``unshare`` and /dev/net/tun.
"""

from __future__ import annotations

import argparse
import fcntl
import os
import socket
import struct
import subprocess
import sys
import threading
import time
from collections.abc import Callable

import numpy as np

from bus_schema.arrays import Vector
from bus_schema.link.configuration import LinkConfiguration
from plant_emulator.channel.channel import Channel
from plant_emulator.channel.opening import DOWNLINK, UPLINK, answer_ns, open_channel

_HERE, _THERE, _PORT = "10.98.0.1", "10.98.0.2", 7600
_TUNSETIFF, _IFF_TUN, _IFF_NO_PI = 0x400454CA, 0x0001, 0x1000
_SIZE = 100
_INSIDE = "--inside"
_FAR_NS = 10**12


def link_of(delay_ms: float, loss: float, transport: str) -> LinkConfiguration:
    """Return a link that delays and loses alike in both directions."""
    way = {"delay_ms": delay_ms, "loss": loss}
    return LinkConfiguration.model_validate(
        {"uplink": way, "downlink": way, "transport": transport}
    )


class LossyWire:
    """Passes IP packets of a TUN device back to it, with source and destination exchanged.

    So two sockets of one host talk over it; checksums stay valid. Each direction has a channel.

    Args:
        link: what happens to packets.
    """

    def __init__(self, link: LinkConfiguration) -> None:
        self._device = os.open("/dev/net/tun", os.O_RDWR)
        fcntl.ioctl(self._device, _TUNSETIFF, struct.pack("16sH", b"lossy", _IFF_TUN | _IFF_NO_PI))
        for words in (f"addr add {_HERE}/24 dev lossy", "link set lossy up", "link set lo up"):
            subprocess.run(["ip", *words.split()], check=True)
        self._there: Channel[bytes] = open_channel(link.downlink, 1, DOWNLINK)
        self._back: Channel[bytes] = open_channel(link.uplink, 1, UPLINK)
        self._lock = threading.Lock()
        for task in (self._read, self._write):
            threading.Thread(target=task, daemon=True).start()

    def _read(self) -> None:
        while packet := os.read(self._device, 4096):
            if packet[0] >> 4 != 4:
                continue
            turned = packet[:12] + packet[16:20] + packet[12:16] + packet[20:]
            to_port = struct.unpack("!H", packet[22:24])[0]
            with self._lock:
                channel = self._there if to_port == _PORT else self._back
                channel.send(turned, time.monotonic_ns(), len(packet))

    def _write(self) -> None:
        while True:
            with self._lock:
                now_ns = time.monotonic_ns()
                due = self._there.take_due(now_ns) + self._back.take_due(now_ns)
                next_ns = min(self._there.next_due_ns, self._back.next_due_ns)
            for _, packet in due:
                os.write(self._device, packet)
            time.sleep(1e-9 * min(max(next_ns - time.monotonic_ns(), 0), 200_000))


def kernel_round_trips_ms(count: int, period_s: float) -> Vector:
    """Return how long requests took until their answers came, one after the other."""
    near, far = _connected()
    threading.Thread(target=_answer, args=(far,), daemon=True).start()
    found = []
    for _ in range(count):
        begun_ns = time.monotonic_ns()
        near.sendall(bytes(_SIZE))
        _read_whole(near)
        found.append(1e-6 * (time.monotonic_ns() - begun_ns))
        time.sleep(max(0.0, period_s - 1e-3 * found[-1]))
    return np.array(found)


def kernel_stream_ms(count: int, period_s: float) -> Vector:
    """Return how long messages of a stream took to be read at the other end."""
    near, far = _connected()

    def write() -> None:
        begin_s = time.monotonic()
        for number in range(count):
            time.sleep(max(0.0, begin_s + number * period_s - time.monotonic()))
            near.sendall(struct.pack("!q", time.monotonic_ns()) + bytes(_SIZE - 8))

    threading.Thread(target=write, daemon=True).start()
    found = []
    for _ in range(count):
        (sent_ns,) = struct.unpack("!q", _read_whole(far)[:8])
        found.append(1e-6 * (time.monotonic_ns() - sent_ns))
    return np.array(found)


def emulated_round_trips_ms(link: LinkConfiguration, count: int, period_s: float) -> Vector:
    """Return what requests and answers take in virtual time, each after the one before."""
    there: Channel[None] = open_channel(link.downlink, 2, DOWNLINK, (), answer_ns(link, DOWNLINK))
    back: Channel[None] = open_channel(link.uplink, 2, UPLINK, (), answer_ns(link, UPLINK))
    found, now_ns = [], 0
    for _ in range(count):
        there.send(None, now_ns, _SIZE)
        [(arrived_ns, _)] = there.take_due(now_ns + _FAR_NS)
        back.send(None, arrived_ns, _SIZE)
        [(returned_ns, _)] = back.take_due(arrived_ns + _FAR_NS)
        found.append(1e-6 * (returned_ns - now_ns))
        now_ns += _FAR_NS + _FAR_NS + round(1e9 * period_s)
    return np.array(found)


def emulated_stream_ms(link: LinkConfiguration, count: int, period_s: float) -> Vector:
    """Return what the messages of a stream take in virtual time."""
    channel: Channel[int] = open_channel(link.downlink, 2, DOWNLINK, (), answer_ns(link, DOWNLINK))
    due = []
    for number in range(count):
        sent_ns = round(1e9 * number * period_s)
        due += channel.take_due(sent_ns)
        channel.send(sent_ns, sent_ns, _SIZE)
    due += channel.take_due(round(1e9 * count * period_s) + _FAR_NS)
    return np.array([1e-6 * (due_ns - sent_ns) for due_ns, sent_ns in due])


def _connected() -> tuple[socket.socket, socket.socket]:
    with socket.create_server((_HERE, _PORT)) as listener:
        near = socket.create_connection((_THERE, _PORT))
        far, _ = listener.accept()
    for each in (near, far):
        each.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    return near, far


def _answer(far: socket.socket) -> None:
    while data := _read_whole(far):
        far.sendall(data)


def _read_whole(source: socket.socket) -> bytes:
    data = b""
    while len(data) < _SIZE and (more := source.recv(_SIZE - len(data))):
        data += more
    return data


def _row(name: str, delays_ms: Vector) -> str:
    shares = (50, 90, 98, 99, 99.9)
    values = " | ".join(f"{value:.1f}" for value in np.percentile(delays_ms, shares))
    return f"| {name} | {values} | {delays_ms.max():.1f} |"


def _measure(options: argparse.Namespace) -> None:
    count, period_s = options.count, 1e-3 * options.period_ms
    emulated = link_of(options.delay_ms, options.loss, "tcp")
    LossyWire(link_of(options.delay_ms, options.loss, "udp"))
    ways: dict[str, tuple[Callable[[], Vector], Callable[[], Vector]]] = {
        "request and response": (
            lambda: kernel_round_trips_ms(count, period_s),
            lambda: emulated_round_trips_ms(emulated, count, period_s),
        ),
        "stream": (
            lambda: kernel_stream_ms(count, period_s),
            lambda: emulated_stream_ms(emulated, count, period_s),
        ),
    }
    print("| | p50 | p90 | p98 | p99 | p99.9 | largest |\n|---|---|---|---|---|---|---|")
    for name, (kernel, model) in ways.items():
        print(_row(f"{name}, kernel", kernel()), flush=True)
        print(_row(f"{name}, emulated", model()), flush=True)


def main() -> None:
    """Measure in a network namespace of its own."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--count", type=int, default=3000)
    parser.add_argument("--period-ms", type=float, default=10.0)
    parser.add_argument("--delay-ms", type=float, default=1.0, help="one way")
    parser.add_argument("--loss", type=float, default=0.01)
    parser.add_argument(_INSIDE, action="store_true", help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.inside:
        _measure(options)
        return
    command = ["unshare", "-rn", sys.executable, "-m", "scripts.experiments.tcp_beside_kernel"]
    raise SystemExit(subprocess.run([*command, *sys.argv[1:], _INSIDE], check=False).returncode)


if __name__ == "__main__":
    main()
