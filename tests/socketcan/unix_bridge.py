"""The other end of `can_over_unix.c`: carries frames between a program and a python-can bus."""

from __future__ import annotations

import shutil
import socket
import struct
import subprocess
import threading
from collections.abc import Iterator
from contextlib import closing, contextmanager
from pathlib import Path

from bus_schema.can.frame import CanBus, CanFrame
from bus_schema.can.session import open_can_bus
from bus_schema.link.can_configuration import CanConfiguration

_CLASSICAL, _FD = struct.Struct("<IB3x8s"), struct.Struct("<IBB2x64s")
_POLL_S = 0.001
_COMPILER = shutil.which("cc")


def frame_of(packet: bytes) -> CanFrame:
    """A frame in the kernel's format (struct can_frame, struct canfd_frame)."""
    if len(packet) == _FD.size:
        identifier, length, _, data = _FD.unpack(packet)
        return CanFrame(identifier, data[:length], is_fd=True)
    identifier, length, data = _CLASSICAL.unpack(packet)
    return CanFrame(identifier, data[:length])


def packet_of(frame: CanFrame) -> bytes:
    """The reverse."""
    head = frame.identifier, len(frame.data)
    return _FD.pack(*head, 0, frame.data) if frame.is_fd else _CLASSICAL.pack(*head, frame.data)


@contextmanager
def program_on_bus(channel: str, folder: Path) -> Iterator[dict[str, str]]:
    """Variables of the environment with which a program's CAN socket is on a virtual bus."""
    library, path = folder / "can_over_unix.so", folder / "can.socket"
    source = Path(__file__).with_name("can_over_unix.c")
    subprocess.run([str(_COMPILER), "-shared", "-fPIC", "-o", library, source, "-ldl"], check=True)
    over = threading.Event()
    place = CanConfiguration(interface="virtual", channel=channel)
    with (
        closing(open_can_bus(place)) as bus,
        socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET) as listener,
    ):
        listener.bind(str(path))
        listener.listen()
        listener.settimeout(_POLL_S)
        carrier = threading.Thread(target=_carry, args=(listener, bus, over))
        carrier.start()
        try:
            yield {"LD_PRELOAD": str(library), "CAN_OVER_UNIX": str(path)}
        finally:
            over.set()
            carrier.join()


def _carry(listener: socket.socket, bus: CanBus, over: threading.Event) -> None:
    program: socket.socket | None = None
    while not over.is_set():
        try:
            if program is None:
                program, _ = listener.accept()
                program.settimeout(_POLL_S)
            if packet := program.recv(_FD.size):
                bus.send(frame_of(packet))
                continue  # a program sends to all motors, then reads
        except TimeoutError:
            pass
        except OSError:  # it has left
            continue
        while program is not None and (frame := bus.receive(0.0)) is not None:
            try:
                program.send(packet_of(frame))
            except OSError:
                break
    if program is not None:
        program.close()
