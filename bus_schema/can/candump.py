"""Logs of CAN frames in the format of ``candump -L``, which every CAN tool reads."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from bus_schema.can.frame import CanFrame

_ERROR_FLAG = 0x2000_0000
_BIT_RATE_SWITCH = 1


def candump_line(time_ns: int, channel: str, frame: CanFrame) -> str:
    """A frame as ``candump -L`` writes it: ``(seconds.microseconds) channel identifier#data``."""
    time_us = time_ns // 1000
    identifier, data, is_extended, is_remote, is_error, is_fd = frame
    if is_error:
        identifier |= _ERROR_FLAG
    name = f"{identifier:08X}" if is_extended or is_error else f"{identifier:03X}"
    content = "R" if is_remote else data.hex().upper()
    mark = f"##{_BIT_RATE_SWITCH}" if is_fd else "#"
    return f"({time_us // 1_000_000}.{time_us % 1_000_000:06d}) {channel} {name}{mark}{content}"


class CandumpLog:
    """A file of frames.

    Args:
        path: the file; overwritten.
        channel: name of the bus.
    """

    def __init__(self, path: Path, channel: str) -> None:
        self._file = path.open("w")
        self._channel = channel

    def write(self, times_ns: Iterable[int], frames: Iterable[CanFrame]) -> None:
        """Append frames."""
        self._file.writelines(
            candump_line(time_ns, self._channel, frame) + "\n"
            for time_ns, frame in zip(times_ns, frames, strict=True)
        )

    def close(self) -> None:
        """Finish the file."""
        self._file.close()
