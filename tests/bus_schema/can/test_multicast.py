"""UDP multicast in python-can's format: the same bytes, and python-can at the other end."""

from __future__ import annotations

import socket
from collections.abc import Iterator

import can
import msgpack
import pytest
from can.interfaces.udp_multicast.utils import pack_message
from hypothesis import given
from hypothesis import strategies as st

from bus_schema.can.frame import CanBus, CanFrame
from bus_schema.can.session import open_can_bus
from bus_schema.errors import BusError
from bus_schema.link.can_configuration import CanConfiguration
from tests.multicast import own_place

GROUP, PORT = own_place()
WAIT_S = 60.0
standard = st.integers(0, 0x7FF)
frames = st.one_of(
    st.tuples(standard, st.binary(max_size=8)).map(lambda given: CanFrame(*given)),
    st.tuples(st.integers(0, 0x1FFFFFFF), st.binary(max_size=8)).map(
        lambda given: CanFrame(*given, is_extended=True)
    ),
    standard.map(lambda identifier: CanFrame(identifier, is_remote=True)),
    st.tuples(standard, st.sampled_from((0, 8, 12, 64))).map(
        lambda given: CanFrame(given[0], bytes(range(given[1])), is_fd=True)
    ),
    st.just(CanFrame(0x181, b"\xa4data\xc4\x08")),  # data that looks like the key before it
)


@pytest.fixture(scope="module")
def ours() -> Iterator[CanBus]:
    bus = open_can_bus(CanConfiguration(
        interface="udp_multicast", channel=GROUP, port=PORT, fd=True
    ))  # fmt: skip
    yield bus
    bus.close()


@pytest.fixture(scope="module")
def theirs() -> Iterator[can.BusABC]:
    with can.Bus(interface="udp_multicast", channel=GROUP, port=PORT, hop_limit=0) as bus:
        yield bus


def message_of(frame: CanFrame) -> can.Message:
    return can.Message(
        arbitration_id=frame.identifier, data=frame.data, is_extended_id=frame.is_extended,
        is_remote_frame=frame.is_remote, is_fd=frame.is_fd, bitrate_switch=frame.is_fd,
    )  # fmt: skip


@given(frames)
def test_datagrams_are_those_of_python_can(ours: CanBus, frame: CanFrame) -> None:
    with listener() as witness:
        ours.send(frame)
        assert witness.recv(4096) == pack_message(message_of(frame))


@given(frames)
def test_frames_of_python_can_are_received(ours, theirs, frame):
    theirs.send(message_of(frame))
    assert ours.receive(WAIT_S) == frame
    assert theirs.recv(WAIT_S) is not None  # python-can hears itself


def packed(**fields: object) -> bytes:
    """A datagram like a frame's, but for these fields."""
    frame = msgpack.unpackb(pack_message(message_of(CanFrame(0x181, bytes(8)))))
    return bytes(msgpack.packb(frame | fields))


@pytest.mark.parametrize(
    "datagram",
    [
        packed(arbitration_id=1.5), packed(arbitration_id=True), packed(arbitration_id=-1),
        packed(is_fd=0.0), packed(is_extended_id="x"), packed(is_remote_frame=[]),
        packed(is_error_frame=2), packed(data=8), packed(data=2**40), packed(data=[0] * 8),
        packed(data=bytes(65), dlc=65, is_fd=True), packed(dlc=8.0, data="12345678"),
        b"", b"\xa4data\xc4", b"\xa4data\xc4\xff", b"rubbish", bytes(4000),
        pack_message(message_of(CanFrame(0x181, bytes(8)))).replace(b"dlc\x08", b"dlc\x07"),
        pack_message(message_of(CanFrame(0x181, bytes(8))))[:-1],
    ],
)  # fmt: skip
def test_invalid_datagrams_are_ignored(ours: CanBus, theirs: can.BusABC, datagram: bytes) -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as stranger:
        stranger.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_TTL, 0)
        stranger.sendto(datagram, (GROUP, PORT))
    frame, before = CanFrame(0x181, b"\1\2"), ours.dropped()
    theirs.send(message_of(frame))
    assert ours.receive(WAIT_S) == frame
    assert before is not None
    assert ours.dropped() == before + 1


def test_own_frames_neither_come_back_nor_count_as_dropped(ours: CanBus) -> None:
    before = ours.dropped()
    for _ in range(100):
        ours.send(CanFrame(0x181))
    assert ours.receive(0.05) is None
    assert ours.dropped() == before


def test_fd_frames_reach_a_node_that_sends_none(theirs: can.BusABC) -> None:
    bus = open_can_bus(CanConfiguration(interface="udp_multicast", channel=GROUP, port=PORT))
    with pytest.raises(BusError, match="FD"):
        bus.send(CanFrame(0x181, is_fd=True))
    theirs.send(message_of(CanFrame(0x181, is_fd=True)))
    theirs.send(message_of(CanFrame(0x182)))
    assert bus.receive(WAIT_S) == CanFrame(0x181, is_fd=True)
    assert bus.receive(WAIT_S) == CanFrame(0x182)
    bus.close()
    with pytest.raises(BusError):
        bus.receive(0.0)


def listener() -> socket.socket:
    """A socket in the group that python-can has no part in."""
    witness = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    witness.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    witness.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEPORT, 1)
    witness.bind(("", PORT))
    group = socket.inet_aton(GROUP) + socket.inet_aton("0.0.0.0")
    witness.setsockopt(socket.IPPROTO_IP, socket.IP_ADD_MEMBERSHIP, group)
    witness.settimeout(WAIT_S)
    return witness
