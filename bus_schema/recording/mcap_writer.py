"""mcap's writer, at a third of the time for what there are thousands of a second.

The file is the same, byte for byte. mcap packs messages and their entries in indices field by
field; here each message's head, and all entries of an index, are packed at once. All else is left
to mcap.
"""

from __future__ import annotations

import struct
from typing import IO

from mcap._chunk_builder import ChunkBuilder
from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import Channel, MessageIndex, Schema, Statistics
from mcap.writer import CompressionType, Writer

_MESSAGE = struct.Struct("<BQHIQQ")  # opcode, length, channel, sequence, log time, publish time
_MESSAGE_BYTES = struct.calcsize("<HIQQ")  # of its content, but for the payload
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

    @property
    def is_full(self) -> bool:
        """Whether the chunk is as large as one should be."""
        return self._chunk.count > self._chunk_bytes

    def add_message(
        self, channel_id: int, log_time: int, data: bytes, publish_time: int, sequence: int = 0
    ) -> None:
        """Add a message to the chunk.

        Raises:
            struct.error: a number that MCAP has no room for.
        """
        length = len(data) + _MESSAGE_BYTES
        head = _MESSAGE.pack(Opcode.MESSAGE, length, channel_id, sequence, log_time, publish_time)
        self._chunk.add(channel_id, log_time, head, data)


class _QuickChunk(ChunkBuilder):
    """A chunk in the making, whose messages count once it is in the file."""

    def __init__(self, statistics: Statistics) -> None:
        super().__init__()
        self._statistics = statistics
        self._parts: list[bytes] = []
        self._size = 0
        self._entries: dict[int, list[int]] = {}  # log time and place of messages, by channel

    @property
    def count(self) -> int:
        return self._size

    def add(self, channel: int, log_ns: int, head: bytes, data: bytes) -> None:
        entries = self._entries.get(channel)
        if entries is None:
            entries = self._entries[channel] = []
        entries += (log_ns, self._size)
        self._parts += (head, data)
        self._size += len(head) + len(data)
        self.num_messages += 1

    def add_schema(self, schema: Schema) -> None:
        super().add_schema(schema)
        self._keep_record()

    def add_channel(self, channel: Channel) -> None:
        super().add_channel(channel)
        self._keep_record()

    def end(self) -> bytes:
        times_ns = [entries[::2] for entries in self._entries.values()]
        self.message_start_time = min(map(min, times_ns))
        self.message_end_time = max(map(max, times_ns))
        for channel, entries in self._entries.items():
            self.message_indices[channel] = _QuickIndex(channel, entries)  # type: ignore[arg-type]
        return b"".join(self._parts)

    def reset(self) -> None:
        """Begin the next one: this one is in the file."""
        self._count()
        super().reset()  # type: ignore[no-untyped-call]
        self._parts, self._size, self._entries = [], 0, {}

    def _keep_record(self) -> None:
        record = self.record_writer.end()  # type: ignore[no-untyped-call]
        self._parts.append(record)
        self._size += len(record)

    def _count(self) -> None:
        counts, is_first = self._statistics, self._statistics.message_count == 0
        start_ns = self.message_start_time if is_first else counts.message_start_time
        counts.message_start_time = min(start_ns, self.message_start_time)
        counts.message_end_time = max(counts.message_end_time, self.message_end_time)
        counts.message_count += self.num_messages
        for channel, entries in self._entries.items():
            counts.channel_message_counts[channel] += len(entries) // 2


class _QuickIndex(MessageIndex):
    """An index whose entries are one list: log time and place of each in turn."""

    def write(self, stream: RecordBuilder) -> None:
        entries = struct.pack(f"<{len(self.records)}Q", *self.records)
        size = len(entries)
        stream.write(_INDEX.pack(Opcode.MESSAGE_INDEX, _INDEX_BYTES + size, self.channel_id, size))
        stream.write(entries)
