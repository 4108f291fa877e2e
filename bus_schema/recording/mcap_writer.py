"""mcap's writer, at a third of the time for what there are thousands of a second.

The file is the same, byte for byte. mcap packs messages and their entries in indices field by
field; here each message's head, and all entries of an index, are packed at once. All else is left
to mcap.
"""

from __future__ import annotations

import struct
import sys
from collections import Counter, defaultdict
from functools import cache
from io import BytesIO
from typing import IO

from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import Channel, MessageIndex, Schema, Statistics
from mcap.writer import CompressionType, Writer

try:
    from mcap._chunk_builder import ChunkBuilder
except ImportError:  # mcap keeps it to itself
    ChunkBuilder = object  # type: ignore[assignment, misc]

_MESSAGE = struct.Struct("<BQHIQQ")  # opcode, length, channel, sequence, log time, publish time
_IS_MESSAGE = int(Opcode.MESSAGE)
_MESSAGE_BYTES = struct.calcsize("<HIQQ")  # of its content, but for the payload
_INDEX = struct.Struct("<BQHI")  # opcode, length, channel, bytes of all entries
_INDEX_BYTES = struct.calcsize("<HI")


class PlainWriter(Writer):
    """The same messages and methods by what mcap makes public, at three times the time.

    Args:
        file: empty.
        chunk_bytes: size of a chunk, not packed, beyond which it is full.
    """

    def __init__(self, file: IO[bytes], chunk_bytes: int) -> None:
        super().__init__(
            file,
            chunk_size=sys.maxsize,
            compression=CompressionType.ZSTD,
            enable_data_crcs=True,
        )
        self._chunk_bytes, self._bytes = chunk_bytes, 0
        self._waiting: Counter[int] = Counter()

    def add_message(
        self, channel_id: int, log_time: int, data: bytes, publish_time: int, sequence: int = 0
    ) -> bool:
        """Add a message to the chunk; whether that is as large now as one should be."""
        super().add_message(channel_id, log_time, data, publish_time, sequence)
        self._waiting[channel_id] += 1
        self._bytes += len(data) + _MESSAGE.size
        return self._bytes > self._chunk_bytes

    def flush(self) -> None:
        """End the chunk, and write it."""
        super().flush()  # type: ignore[no-untyped-call]
        self._waiting.clear()
        self._bytes = 0

    def waiting(self, channel_id: int) -> int:
        """How many messages of a channel wait in the chunk."""
        return self._waiting[channel_id]


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
        own = vars(self)  # what mcap keeps to itself, as of 1.6; see `can_be_quick`
        self._chunk = own["_Writer__chunk_builder"] = _QuickChunk(own["_Writer__statistics"])
        self._chunk_bytes = chunk_bytes

    def add_message(
        self, channel_id: int, log_time: int, data: bytes, publish_time: int, sequence: int = 0
    ) -> bool:
        """Add a message to the chunk; whether that is as large now as one should be.

        Raises:
            struct.error: a number that MCAP has no room for.
        """
        length = len(data) + _MESSAGE_BYTES
        head = _MESSAGE.pack(_IS_MESSAGE, length, channel_id, sequence, log_time, publish_time)
        chunk = self._chunk
        content, entries = chunk.content, chunk.entries[channel_id]
        entries += (log_time, len(content))
        content += head
        content += data
        chunk.num_messages += 1
        return len(content) > self._chunk_bytes

    def waiting(self, channel_id: int) -> int:
        """How many messages of a channel wait in the chunk."""
        return len(self._chunk.entries.get(channel_id, ())) // 2


class _QuickChunk(ChunkBuilder):
    """A chunk in the making, whose messages count once it is in the file.

    Attributes:
        content: its bytes so far.
        entries: log time and place of each message in turn, by channel.
    """

    def __init__(self, statistics: Statistics) -> None:
        super().__init__()
        self._statistics = statistics
        self.content = bytearray()
        self.entries: defaultdict[int, list[int]] = defaultdict(list)

    @property
    def count(self) -> int:
        return len(self.content)

    def add_schema(self, schema: Schema) -> None:
        super().add_schema(schema)
        self._keep_record()

    def add_channel(self, channel: Channel) -> None:
        super().add_channel(channel)
        self._keep_record()

    def end(self) -> bytearray:
        times_ns = [entries[::2] for entries in self.entries.values()]
        self.message_start_time = min(map(min, times_ns))
        self.message_end_time = max(map(max, times_ns))
        for channel, entries in self.entries.items():
            self.message_indices[channel] = _QuickIndex(channel, entries)  # type: ignore[arg-type]
        return self.content

    def reset(self) -> None:
        """Begin the next one: this one is in the file."""
        self._count()
        super().reset()  # type: ignore[no-untyped-call]
        self.content, self.entries = bytearray(), defaultdict(list)

    def _keep_record(self) -> None:
        self.content += self.record_writer.end()  # type: ignore[no-untyped-call]

    def _count(self) -> None:
        counts, is_first = self._statistics, self._statistics.message_count == 0
        start_ns = self.message_start_time if is_first else counts.message_start_time
        counts.message_start_time = min(start_ns, self.message_start_time)
        counts.message_end_time = max(counts.message_end_time, self.message_end_time)
        counts.message_count += self.num_messages
        for channel, entries in self.entries.items():
            counts.channel_message_counts[channel] += len(entries) // 2


class _QuickIndex(MessageIndex):
    """An index whose entries are one list: log time and place of each in turn."""

    def write(self, stream: RecordBuilder) -> None:
        entries = struct.pack(f"<{len(self.records)}Q", *self.records)
        size = len(entries)
        stream.write(_INDEX.pack(Opcode.MESSAGE_INDEX, _INDEX_BYTES + size, self.channel_id, size))
        stream.write(entries)


@cache
def can_be_quick() -> bool:
    """Whether mcap is inside as `QuickWriter` knows it: a small file is the same either way."""
    try:
        return _small_file(QuickWriter) == _small_file(PlainWriter)
    except (AttributeError, KeyError, TypeError):
        return False


def _small_file(kind: type[QuickWriter | PlainWriter]) -> bytes:
    """Two chunks with two channels, whose times go back."""
    file = BytesIO()
    writer = kind(file, 1024)
    writer.start()
    for name in ("one", "two"):
        writer.register_channel(name, "cdr", writer.register_schema(name, "ros2msg", b"bool x"))
    for number in (3, 1, 2, 4):
        writer.add_message(1 + number % 2, number, b"data", number, number)
        if number == 1:
            writer.flush()
    writer.finish()  # type: ignore[no-untyped-call]
    return file.getvalue()
