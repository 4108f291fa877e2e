"""Logs of CAN frames in the format of ``candump -L``, which every CAN tool reads."""

from __future__ import annotations

from pathlib import Path

from bus_schema.can.frame import CanFrame

_ERROR_FLAG = 0x2000_0000
_BIT_RATE_SWITCH = 1


def candump_line(time_ns: int, channel: str, frame: CanFrame) -> str:
    """A frame as ``candump -L`` writes it: ``(seconds.microseconds) channel identifier#data``."""
    seconds, rest_us = divmod(time_ns // 1000, 1_000_000)
    identifier, data, is_extended, is_remote, is_error, is_fd = frame
    if is_error:
        identifier |= _ERROR_FLAG
    name = f"{identifier:08X}" if is_extended or is_error else f"{identifier:03X}"
    content = "R" if is_remote else data.hex().upper()
    mark = f"##{_BIT_RATE_SWITCH}" if is_fd else "#"
    return f"({seconds}.{rest_us:06d}) {channel} {name}{mark}{content}"


class CandumpLog:
    """A file of frames.

    Args:
        path: the file; overwritten.
        channel: name of the bus.
    """

    def __init__(self, path: Path, channel: str) -> None:
        self._file = path.open("w")
        self._channel = channel

    def write(self, time_ns: int, frame: CanFrame) -> None:
        """Append a frame."""
        self._file.write(candump_line(time_ns, self._channel, frame) + "\n")

    def close(self) -> None:
        """Finish the file."""
        self._file.close()
