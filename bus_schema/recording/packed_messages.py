"""Messages as records of an MCAP file: those of many ticks are packed as fast as those of one."""

from __future__ import annotations

import struct
from collections.abc import Sequence
from functools import lru_cache

import numpy as np
from mcap.opcode import Opcode
from numpy.typing import NDArray

HEAD = struct.Struct("<BQHIQQ")  # opcode, length, channel, sequence, log time, publish time
IS_MESSAGE = int(Opcode.MESSAGE)
COUNTED_BYTES = struct.calcsize("<HIQQ")  # of the head, in the length; the payload is too
_HEAD_TYPE = np.dtype(
    [
        ("opcode", "u1"), ("length", "<u8"), ("channel", "<u2"), ("sequence", "<u4"),
        ("log_time", "<u8"), ("publish_time", "<u8"),
    ]
)  # fmt: skip


class PackedMessages:
    """Messages of some ticks, the same channels and sizes at each, as records one after another.

    Args:
        channels: of the messages of a tick in turn.
        sequences: their numbers, shape (ticks, channels); of larger ones the lowest 32 bits count.
        log_times: not negative; same shape.
        publish_times: not negative; same shape.
        payloads: of each channel, shape (ticks, bytes).

    Attributes:
        content: the bytes of all records.
        entries: channel, log time and place in the content of each message, shape (messages, 3).
        ends: where in the content each message ends.
    """

    def __init__(
        self,
        channels: tuple[int, ...],
        sequences: NDArray[np.int64],
        log_times: NDArray[np.int64],
        publish_times: NDArray[np.int64],
        payloads: Sequence[NDArray[np.uint8]],
    ) -> None:
        sizes = tuple(payload.shape[1] for payload in payloads)
        tick, tick_type, offsets, bytes_of = _layout(channels, sizes)
        records = bytearray(tick * len(sequences))
        table = np.frombuffer(records, tick_type)
        for place, payload in enumerate(payloads):
            head = table[f"head{place}"]
            head["sequence"] = sequences[:, place]
            head["log_time"] = log_times[:, place]
            head["publish_time"] = publish_times[:, place]
            table[f"payload{place}"] = payload
        self.content = memoryview(records)
        ticks = np.arange(0, len(records), len(tick))
        begins = ticks[:, None] + offsets
        self.ends: list[int] = (begins + bytes_of).ravel().tolist()
        self.entries = np.empty((*sequences.shape, 3), np.int64)
        self.entries[:, :, 0] = channels
        self.entries[:, :, 1] = log_times
        self.entries[:, :, 2] = begins
        self.entries = self.entries.reshape(-1, 3)


@lru_cache(maxsize=64)
def _layout(
    channels: tuple[int, ...], sizes: tuple[int, ...]
) -> tuple[bytes, np.dtype[np.void], NDArray[np.int64], NDArray[np.int64]]:
    """A tick's records without what changes, their type, and place and size of each."""
    fields: list[tuple[str, object]] = []
    tick = b""
    for place, (channel, size) in enumerate(zip(channels, sizes, strict=True)):
        fields += [(f"head{place}", _HEAD_TYPE), (f"payload{place}", ("u1", size))]
        tick += HEAD.pack(IS_MESSAGE, COUNTED_BYTES + size, channel, 0, 0, 0) + bytes(size)
    bytes_of = np.array(sizes) + HEAD.size
    return tick, np.dtype(fields), np.cumsum(bytes_of) - bytes_of, bytes_of
