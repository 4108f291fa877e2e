"""mcap's writer, at a third of the time for what there are thousands of a second.

The file is the same, byte for byte. mcap packs messages and their entries in indices field by
field; here each message's head, and all entries of an index, are packed at once, and messages of
many ticks may come as one. All else is left to mcap.
"""

from __future__ import annotations

import struct
from array import array
from bisect import bisect_right
from collections.abc import Iterator
from typing import IO

import numpy as np
from mcap._chunk_builder import ChunkBuilder
from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import Channel, MessageIndex, Schema, Statistics
from mcap.writer import CompressionType, Writer
from numpy.typing import NDArray

from bus_schema.recording.packed_messages import COUNTED_BYTES, HEAD, IS_MESSAGE, PackedMessages

_INDEX = struct.Struct("<BQHI")  # opcode, length, channel, bytes of all entries
_INDEX_BYTES = struct.calcsize("<HI")


class QuickWriter(Writer):
    """Writes an MCAP file in chunks, with all checksums.

    Messages wait for the end of their chunk; who adds them ends it by `flush` when it is full.

    Args:
        file: empty.
        chunk_bytes: size of a chunk, not packed, beyond which it is full.
    """

    def __init__(self, file: IO[bytes], chunk_bytes: int) -> None:
        super().__init__(
            file,
            chunk_size=chunk_bytes,
            compression=CompressionType.ZSTD,
            enable_data_crcs=True,
        )
        own = vars(self)  # what mcap keeps to itself, as of 1.6
        self._chunk = own["_Writer__chunk_builder"] = _QuickChunk(own["_Writer__statistics"])
        self._chunk_bytes = chunk_bytes

    def add_message(
        self, channel_id: int, log_time: int, data: bytes, publish_time: int, sequence: int = 0
    ) -> bool:
        """Add a message to the chunk; whether that is as large now as one should be.

        Raises:
            struct.error: a number that MCAP has no room for.
        """
        length = len(data) + COUNTED_BYTES
        head = HEAD.pack(IS_MESSAGE, length, channel_id, sequence, log_time, publish_time)
        chunk = self._chunk
        content = chunk.content
        chunk.entries.extend((channel_id, log_time, len(content)))
        content += head
        content += data
        chunk.num_messages += 1
        return len(content) > self._chunk_bytes

    def add_packed(self, messages: PackedMessages, first: int, end: int) -> tuple[int, bool]:
        """Add messages from the first up to the end, or until the chunk is full.

        Which is the next one to add, and whether the chunk is as large now as one should be.
        """
        chunk = self._chunk
        content, ends = chunk.content, messages.ends
        begin = ends[first - 1] if first else 0
        room = begin + self._chunk_bytes - len(content)
        end = min(end, bisect_right(ends, room) + 1)  # the last one makes it full
        entries = messages.entries[first:end].copy()
        entries[:, 2] += len(content) - begin
        chunk.entries.frombytes(entries.tobytes())
        content += messages.content[begin : ends[end - 1]]
        chunk.num_messages += end - first
        return end, len(content) > self._chunk_bytes

    def waiting(self) -> dict[int, int]:
        """How many messages of each channel wait in the chunk."""
        counts = np.bincount(self._chunk.table()[:, 0].astype(np.intp))
        return dict(enumerate(counts.tolist()))


class _QuickChunk(ChunkBuilder):
    """A chunk in the making, whose messages count once it is in the file.

    Attributes:
        content: its bytes so far.
        entries: channel, log time and place of each message in turn.
    """

    def __init__(self, statistics: Statistics) -> None:
        super().__init__()
        self._statistics = statistics
        self.content = bytearray()
        self.entries = array("Q")

    @property
    def count(self) -> int:
        return len(self.content)

    def table(self) -> NDArray[np.uint64]:
        """The entries, shape (messages, 3): a copy, or nothing could be added meanwhile."""
        return np.frombuffer(self.entries.tobytes(), np.uint64).reshape(-1, 3)

    def add_schema(self, schema: Schema) -> None:
        super().add_schema(schema)
        self._keep_record()

    def add_channel(self, channel: Channel) -> None:
        super().add_channel(channel)
        self._keep_record()

    def end(self) -> bytearray:
        table = self.table()
        self.message_start_time = int(table[:, 1].min())
        self.message_end_time = int(table[:, 1].max())
        for channel, entries in _by_channel(table):
            self.message_indices[channel] = _QuickIndex(channel, entries)  # type: ignore[arg-type]
        return self.content

    def reset(self) -> None:
        """Begin the next one: this one is in the file."""
        self._count()
        super().reset()  # type: ignore[no-untyped-call]
        self.content, self.entries = bytearray(), array("Q")

    def _keep_record(self) -> None:
        self.content += self.record_writer.end()  # type: ignore[no-untyped-call]

    def _count(self) -> None:
        counts, is_first = self._statistics, self._statistics.message_count == 0
        start_ns = self.message_start_time if is_first else counts.message_start_time
        counts.message_start_time = min(start_ns, self.message_start_time)
        counts.message_end_time = max(counts.message_end_time, self.message_end_time)
        counts.message_count += self.num_messages
        for channel, index in self.message_indices.items():
            counts.channel_message_counts[channel] += len(index.records)


def _by_channel(table: NDArray[np.uint64]) -> Iterator[tuple[int, NDArray[np.uint64]]]:
    """Each channel with log times and places of its messages, in the order of their first ones."""
    channels = table[:, 0]
    for channel in dict.fromkeys(channels.tolist()):
        yield channel, table[channels == channel, 1:]


class _QuickIndex(MessageIndex):
    """An index whose entries are one array: log time and place of each."""

    def write(self, stream: RecordBuilder) -> None:
        entries = np.asarray(self.records, "<u8").tobytes()
        size = len(entries)
        stream.write(_INDEX.pack(Opcode.MESSAGE_INDEX, _INDEX_BYTES + size, self.channel_id, size))
        stream.write(entries)
