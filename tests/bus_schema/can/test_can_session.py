"""The CAN session on interfaces that need nothing, and what it says of those it cannot open."""

from __future__ import annotations

import contextlib
import socket
import time
import uuid
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path

import can
import numpy as np
import pytest
from can.interfaces.udp_multicast.utils import pack_message

from bus_schema.can.frame import CanBus, CanFrame
from bus_schema.can.medium import CandumpLog
from bus_schema.can.session import check_can_bus, open_can_bus
from bus_schema.configuration import ConfigurationError
from bus_schema.link.can_configuration import CanConfiguration
from tests.multicast import own_place

HAS_SOCKETCAN = Path("/proc/net/can").exists()


def virtual() -> CanConfiguration:
    return CanConfiguration(interface="virtual", channel=str(uuid.uuid4()))


def multicast(**values: object) -> CanConfiguration:
    group, port = own_place()
    place = {"interface": "udp_multicast", "channel": group, "port": port}
    return CanConfiguration.model_validate({**place, **values})


FRAMES = [
    CanFrame(0x123, b"\x01\x02"),
    CanFrame(0x1ABCDEF, b"12345678", is_extended=True),
    CanFrame(0x181, is_remote=True),
    CanFrame(0x080),
    CanFrame(0x300, bytes(range(64)), is_fd=True),
]


@contextlib.contextmanager
def two_on(configuration: CanConfiguration) -> Iterator[tuple[CanBus, CanBus]]:
    with closing(open_can_bus(configuration)) as one, closing(open_can_bus(configuration)) as other:
        yield one, other


def test_frames_reach_the_others_in_order_and_never_their_sender() -> None:
    with two_on(virtual()) as (ours, theirs):  # by UDP multicast: see test_multicast.py
        for frame in FRAMES:
            ours.send(frame)
        assert [theirs.receive(1.0) for _ in FRAMES] == FRAMES
        theirs.send(FRAMES[0])
        assert ours.receive(1.0) == FRAMES[0]
        assert ours.receive(0.01) is None


def test_frames_dropped_by_the_socket_are_counted() -> None:
    with two_on(multicast()) as (sender, slow):
        assert slow.dropped() == 0
        sent = 2000  # more than a queue of the usual 200 KiB holds
        for _ in range(sent):
            sender.send(FRAMES[0])
        received = 0
        while slow.receive(0.2) is not None:
            received += 1
        assert received < sent
        assert slow.dropped() == sent - received
    assert open_can_bus(virtual()).dropped() is None


_SOON_S = 0.3
_TRIES = 20
_ALL_PROTOCOLS = 3  # ETH_P_ALL: what goes out is shown to no other


@pytest.mark.parametrize(("hop_limit", "leaves"), [(0, False), (1, True)])
def test_frames_leave_the_machine_only_if_they_are_to(hop_limit: int, leaves: bool) -> None:
    try:
        wire = socket.socket(socket.AF_PACKET, socket.SOCK_DGRAM, socket.htons(_ALL_PROTOCOLS))
    except PermissionError:
        pytest.skip("watching the network takes CAP_NET_RAW")
    configuration = multicast(hop_limit=hop_limit)
    with wire, two_on(configuration) as (bus, witness):
        wire.settimeout(_SOON_S)
        group, seen = socket.inet_aton(configuration.resolved_channel), list[bytes]()
        for _ in range(_TRIES if leaves else 1):  # much other traffic may push a frame out of sight
            bus.send(FRAMES[0])
            assert witness.receive(1.0) == FRAMES[0]
            if seen := list(_sent_to_network(wire, group)):
                break
        assert bool(seen) == leaves


@pytest.mark.parametrize(("hop_limit", "is_received"), [(0, False), (1, True)])
def test_datagrams_from_other_machines_or_to_other_groups_are_ignored(hop_limit, is_received):
    configuration = multicast(hop_limit=hop_limit)
    sender = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    with sender, closing(open_can_bus(configuration)) as bus:
        message = can.Message(arbitration_id=0x123, data=b"x", is_extended_id=False)
        as_from_another_machine = "127.0.0.1", configuration.port
        sender.sendto(pack_message(message), as_from_another_machine)
        assert (bus.receive(0.3) is not None) == is_received


def _sent_to_network(wire: socket.socket, group: bytes) -> Iterator[bytes]:
    """IP packets to a group that this machine soon hands to one of its networks, beside others."""
    end_s = time.monotonic() + _SOON_S
    with contextlib.suppress(TimeoutError):
        while time.monotonic() < end_s:
            packet, (_, _, packet_type, *_) = wire.recvfrom(2048)
            if packet_type == socket.PACKET_OUTGOING and packet[16:20] == group:
                yield packet


@pytest.mark.skipif(HAS_SOCKETCAN, reason="this kernel has SocketCAN")
def test_kernel_without_socketcan_is_a_configuration_error_with_advice() -> None:
    """Other buses that cannot be joined: see deploy/cli/refused_settings.py."""
    with pytest.raises(ConfigurationError, match="with-vcan") as refusal:
        check_can_bus(CanConfiguration(interface="socketcan"))
    assert refusal.value.key == "link.can.interface"


@pytest.mark.parametrize(
    ("frame", "line"),
    [
        (CanFrame(0x044, b"\x2a\x36"), "(1.000002) can0 044#2A36"),
        (CanFrame(0x12345, b"", is_extended=True), "(1.000002) can0 00012345#"),
        (CanFrame(0x009, is_remote=True), "(1.000002) can0 009#R"),
        (CanFrame(0x111, b"\xff" * 12, is_fd=True), "(1.000002) can0 111##1" + "FF" * 12),
        (CanFrame(0x111, b"", is_fd=True), "(1.000002) can0 111##1"),
        (CanFrame(0x040, bytes(8), is_error=True), "(1.000002) can0 20000040#" + "00" * 8),
    ],
)
def test_log_lines_are_those_of_candump(frame: CanFrame, line: str, tmp_path: Path) -> None:
    log = CandumpLog(tmp_path / "can.log", "can0")
    times_ns = np.array([1_000_002_999, 12_345_678_901_234])
    log.write(times_ns, [frame, CanFrame(0x7AB, b"\x01")])
    log.close()
    assert (tmp_path / "can.log").read_text() == f"{line}\n(12345.678901) can0 7AB#01\n"
