"""CAN frames, and what a program may ask of a CAN bus."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple, Protocol

BUS_OFF = 0x40
"""Error frame: this controller is off the bus (``CAN_ERR_BUSOFF`` of linux/can/error.h)."""

BUS_RESTARTED = 0x100
"""Error frame: this controller is back on the bus (``CAN_ERR_RESTARTED``)."""


class CanFrame(NamedTuple):
    """One frame.

    Attributes:
        identifier: 11 bits, or 29 if extended; of an error frame, its error class (SocketCAN's
            bits, see `BUS_OFF`).
        data: at most 8 bytes, 64 with CAN FD; of a remote frame, none.
        is_extended: the identifier has 29 bits.
        is_remote: a remote transmission request.
        is_error: no frame from the bus, but a report of the local controller about it.
        is_fd: a CAN FD frame.
    """

    identifier: int
    data: bytes = b""
    is_extended: bool = False
    is_remote: bool = False
    is_error: bool = False
    is_fd: bool = False


def is_data(frame: CanFrame, data_bytes: int, *, is_fd: bool = False) -> bool:
    """Whether it is a data frame of this format with an 11-bit identifier and so many bytes."""
    is_plain = not (frame.is_extended or frame.is_remote or frame.is_error)
    return is_plain and frame.is_fd == is_fd and len(frame.data) == data_bytes


class CanBus(Protocol):
    """A node's access to a bus."""

    def send(self, frame: CanFrame) -> None:
        """Send a frame."""

    def send_all(self, frames: Sequence[CanFrame]) -> None:
        """Send frames one after the other; a waiting receiver may wake up once for all."""
        for frame in frames:
            self.send(frame)

    def receive(self, timeout_s: float) -> CanFrame | None:
        """Return the next frame of another node; None if none arrives within `timeout_s`."""

    def dropped(self) -> int | None:
        """Return the number of frames lost by a slow receiver; None if they are not counted."""

    def close(self) -> None:
        """Leave the bus."""
