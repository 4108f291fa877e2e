"""The CAN session: the only file that imports can."""

from __future__ import annotations

import contextlib
import errno
import logging
import os
import socket
from pathlib import Path
from typing import Any

import can
from can.interfaces.udp_multicast.utils import pack_message, unpack_message

from bus_schema.can.frame import CanBus, CanFrame
from bus_schema.can.multicast import Envelopes, MulticastBus, dropped_by_socket
from bus_schema.configuration import ConfigurationError
from bus_schema.errors import BusError
from bus_schema.link.can_configuration import CanConfiguration

_SEND_TIMEOUT_S = 1.0
_IFF_UP = 1

# What the interfaces report reaches the user in the exceptions they raise.
logging.getLogger("can").setLevel(logging.CRITICAL)


class CanSessionError(BusError, ConnectionError):
    """The bus was lost during a run; the message says on which channel."""


class PythonCanBus(CanBus):
    """A node's access to a bus by way of python-can.

    Args:
        bus: python-can's bus.
        channel: what it is called, for error messages.
    """

    def __init__(self, bus: can.BusABC, channel: str) -> None:
        self._bus = bus
        self._channel = channel

    def send(self, frame: CanFrame) -> None:
        """Send a frame.

        Raises:
            CanSessionError: the interface is down, or its queue stays full for a second.
        """
        try:
            self._bus.send(to_message(frame), timeout=_SEND_TIMEOUT_S)
        except (can.CanError, OSError) as error:
            raise CanSessionError(f"CAN channel {self._channel}: {error}") from error

    def receive(self, timeout_s: float) -> CanFrame | None:
        """The next frame that another node sent; None if none came within `timeout_s`.

        Raises:
            CanSessionError: the interface is down.
        """
        try:
            message = self._bus.recv(timeout_s)
        except (can.CanError, OSError) as error:
            raise CanSessionError(f"CAN channel {self._channel}: {error}") from error
        return None if message is None else _frame(message)

    def dropped(self) -> int | None:
        """Return the number of frames lost by a full socket queue; None if they are not counted."""
        try:
            return dropped_by_socket(self._bus.fileno())
        except (NotImplementedError, OSError):  # no socket, or another kernel than Linux
            return None

    def close(self) -> None:
        """Leave the bus."""
        with contextlib.suppress(can.CanError, OSError):
            self._bus.shutdown()


def to_message(frame: CanFrame) -> can.Message:
    """A frame as python-can has it."""
    return can.Message(
        arbitration_id=frame.identifier,
        data=frame.data,
        is_extended_id=frame.is_extended,
        is_remote_frame=frame.is_remote,
        is_error_frame=frame.is_error,
        is_fd=frame.is_fd,
        bitrate_switch=frame.is_fd,
    )


def _frame(message: can.Message) -> CanFrame:
    return CanFrame(
        message.arbitration_id,
        bytes(message.data),
        message.is_extended_id,
        message.is_remote_frame,
        message.is_error_frame,
        message.is_fd,
    )


def open_can_bus(configuration: CanConfiguration) -> CanBus:
    """Join the bus that section ``link.can`` describes.

    Raises:
        ConfigurationError: there is no such interface or channel, or no right to use it.
    """
    interface, channel = configuration.interface, configuration.resolved_channel
    if interface not in can.VALID_INTERFACES:
        raise ConfigurationError(
            "link.can.interface", interface,
            f"must be an interface of python-can: {', '.join(sorted(can.VALID_INTERFACES))}",
        )  # fmt: skip
    try:
        bus = open_python_can(configuration)
        if interface == "udp_multicast":
            return _over_socket_of(bus, configuration)
    except Exception as error:
        raise _explained(error, configuration) from error
    return PythonCanBus(bus, channel)


def open_python_can(configuration: CanConfiguration) -> can.BusABC:
    """Return python-can's own bus; raises its errors unchanged."""
    interface, channel = configuration.interface, configuration.resolved_channel
    return can.Bus(interface=interface, channel=channel, **_arguments(configuration))


def _over_socket_of(bus: can.BusABC, configuration: CanConfiguration) -> CanBus:
    """A bus on the socket that python-can has opened, and in its format."""

    def pack(frame: CanFrame) -> bytes:
        if frame.is_fd and not configuration.fd:
            raise ValueError("cannot send FD frames with link.can.fd = false")
        return pack_message(to_message(frame))

    def unpack(datagram: bytes) -> CanFrame | None:
        try:
            frame = _frame(unpack_message(datagram, check=True))
        except Exception:  # noqa: BLE001 (the group may carry anything; msgpack raises anything)
            return None
        # python-can takes anything that compares as a number. FD frames are passed on even where
        # this node sends none: their receiver reports them, as real hardware does.
        has_types = type(frame.identifier) is int and all(type(flag) is bool for flag in frame[2:])
        return frame if has_types else None

    try:
        receiver = socket.socket(fileno=os.dup(bus.fileno()))
        receiver.setblocking(False)
        place = configuration.resolved_channel, configuration.port
        return MulticastBus(receiver, place, configuration.hop_limit, Envelopes(pack, unpack))
    finally:
        bus.shutdown()


def check_can_bus(configuration: CanConfiguration) -> None:
    """Join the bus and leave it again, so that what is wrong is known before a run.

    Raises:
        ConfigurationError: as `open_can_bus`; also where nothing could be sent.
    """
    open_can_bus(configuration).close()
    interface, channel = configuration.interface, configuration.resolved_channel
    try:
        if interface == "udp_multicast":
            _require_route(channel, configuration.port)
        elif interface == "socketcan":
            _require_up(channel)
    except OSError as error:
        raise _explained(error, configuration) from error


def _require_route(group: str, port: int) -> None:
    family = socket.AF_INET6 if ":" in group else socket.AF_INET
    with socket.socket(family, socket.SOCK_DGRAM) as sender:
        sender.connect((group, port))


def _require_up(channel: str) -> None:
    flags = int(Path(f"/sys/class/net/{channel}/flags").read_text(), 16)
    if not flags & _IFF_UP:
        raise OSError(errno.ENETDOWN, "Network is down")


def _arguments(configuration: CanConfiguration) -> dict[str, Any]:
    """Return the arguments of this interface; ``ip link`` sets the bit rate of socketcan."""
    rates: dict[str, Any] = {"bitrate": configuration.bitrate}
    if configuration.fd:
        rates |= {"fd": True, "data_bitrate": configuration.data_bitrate}
    others: dict[str, dict[str, Any]] = {
        "virtual": {"protocol": can.CanProtocol.CAN_FD},
        "udp_multicast": {
            "port": configuration.port,
            "fd": configuration.fd,
            "hop_limit": configuration.hop_limit,
        },
        "socketcan": {"fd": configuration.fd},
    }
    return others.get(configuration.interface, rates)


def _explained(error: Exception, configuration: CanConfiguration) -> ConfigurationError:
    """Explain why a bus cannot be joined, and name the remedy."""
    cause = error.__cause__ if isinstance(error.__cause__, OSError) else error
    interface, channel = configuration.interface, configuration.resolved_channel
    key: str = "link.can.channel"
    given: str | int = channel
    match getattr(cause, "errno", None):
        case errno.EAFNOSUPPORT:
            key, given = "link.can.interface", interface
            advice = (
                "this kernel has no SocketCAN; run the command with scripts/with-vcan, which"
                " provides it, or use udp_multicast (virtual for simulate)"
            )
        case errno.ENODEV if interface == "socketcan":
            advice = (
                f"there is no such CAN interface; as root, `ip link add dev {channel} type vcan`"
                f" and `ip link set {channel} up` make a virtual one; `ip link show type can` shows"
                " hardware; scripts/with-vcan runs a command where vcan0 is up"
            )
        case errno.ENETDOWN:
            advice = f"is down; as root: ip link set {channel} up (with `type can bitrate …` first)"
        case errno.EADDRINUSE:
            key, given = "link.can.port", configuration.port
            advice = "is in use by another program on this machine: must be another port"
        case errno.EPERM | errno.EACCES:
            advice = "this user may not open it; join its group, or run as root"
        case _ if interface == "udp_multicast":
            advice = (
                "must be a multicast address that this host has a route to, such as 239.74.163.2"
                f" ({cause})"
            )
        case _:
            key, given = "link.can.interface", interface
            advice = f"cannot be opened on channel {channel!r}, is its driver installed? ({error})"
    return ConfigurationError(key, given, advice)
