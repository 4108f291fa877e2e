"""MCAP files, chunk by chunk: the same bytes as of mcap's own writer, at a third of the time.

What is rare is packed by mcap's records; what there are thousands of a second, messages and their
entries in indices, is packed here.
"""

from __future__ import annotations

import struct
import zlib
from typing import Any, Protocol

import zstandard
from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import (
    Attachment,
    AttachmentIndex,
    Channel,
    Chunk,
    ChunkIndex,
    DataEnd,
    Footer,
    Header,
    McapRecord,
    Metadata,
    MetadataIndex,
    Schema,
    Statistics,
    SummaryOffset,
)
from mcap.writer import MCAP0_MAGIC

_MESSAGE = struct.Struct("<BQHIQQ")  # opcode, length, channel, sequence, log time, publish time
_MESSAGE_BYTES = _MESSAGE.size - struct.calcsize("<BQ")  # of its content, but for the payload
_INDEX = struct.Struct("<BQHI")  # opcode, length, channel, bytes of all entries
_INDEX_BYTES = struct.calcsize("<HI")
_ENTRY_BYTES = struct.calcsize("<QQ")  # log time, place in the chunk
_FOOTER = struct.Struct("<BQQQ")


class File(Protocol):
    """Where a recording goes; what it does not take raises OSError."""

    def write(self, data: bytes, /) -> int: ...

    def tell(self) -> int: ...


class ChunkedWriter:
    """Writes an MCAP file. Messages and channels wait in memory for the end of their chunk.

    Args:
        file: empty.
        profile: of the messages.
        library: who writes it.
        chunk_bytes: size of a chunk, not packed, beyond which it is full.

    Raises:
        OSError: the file does not take what was to be written. So do all methods but those that
            add something to a chunk; after it, nothing can be written.
    """

    def __init__(self, file: File, profile: str, library: str, chunk_bytes: int) -> None:
        self._file, self._chunk_bytes = file, chunk_bytes
        self._crc = 0
        self._parts: list[bytes] = []  # of the chunk
        self._size = 0
        self._entries: dict[int, list[int]] = {}  # log time and place of its messages, by channel
        self._schemas: list[Schema] = []
        self._channels: list[Channel] = []
        self._chunks: list[ChunkIndex] = []
        self._attachments: list[AttachmentIndex] = []
        self._metadata: list[MetadataIndex] = []
        self._counts: dict[int, int] = {}  # messages in chunks that are written, by channel
        self._write(MCAP0_MAGIC)
        self._write(_packed(Header(profile, library)))

    @property
    def is_full(self) -> bool:
        """Whether the chunk is as large as one should be."""
        return self._size > self._chunk_bytes

    def add_schema(self, name: str, encoding: str, data: bytes) -> int:
        """Add a message type; its number."""
        schema = Schema(id=len(self._schemas) + 1, name=name, encoding=encoding, data=data)
        self._schemas.append(schema)
        self._add(_packed(schema))
        return schema.id

    def add_channel(self, topic: str, encoding: str, schema: int, metadata: dict[str, str]) -> int:
        """Add a topic, whose type has the number `schema`; its own number."""
        number = len(self._channels) + 1
        channel = Channel(
            id=number, topic=topic, message_encoding=encoding, metadata=metadata, schema_id=schema
        )
        self._channels.append(channel)
        self._add(_packed(channel))
        return number

    def add_message(
        self, channel: int, log_ns: int, data: bytes, sent_ns: int, sequence: int
    ) -> None:
        """Add a message.

        Raises:
            struct.error: a number that MCAP has no room for.
        """
        length = len(data) + _MESSAGE_BYTES
        head = _MESSAGE.pack(Opcode.MESSAGE, length, channel, sequence, log_ns, sent_ns)
        entries = self._entries.get(channel)
        if entries is None:
            entries = self._entries[channel] = []
        entries += (log_ns, self._size)
        self._parts += (head, data)
        self._size += _MESSAGE.size + len(data)

    def end_chunk(self) -> None:
        """Write the chunk and its indices, if there are messages in it."""
        if not self._entries:
            return
        content = b"".join(self._parts)
        entries, self._entries, self._parts, self._size = self._entries, {}, [], 0
        times_ns = [entry[::2] for entry in entries.values()]
        chunk = Chunk(
            compression="zstd", data=zstandard.compress(content),
            message_start_time=min(map(min, times_ns)), message_end_time=max(map(max, times_ns)),
            uncompressed_crc=zlib.crc32(content), uncompressed_size=len(content),
        )  # fmt: skip
        start, packed = self._file.tell(), _packed(chunk)
        self._write(packed)
        places, indices = _indices(entries, self._file.tell())
        self._write(indices)
        self._chunks.append(
            ChunkIndex(
                message_start_time=chunk.message_start_time,
                message_end_time=chunk.message_end_time,
                chunk_start_offset=start, chunk_length=len(packed),
                message_index_offsets=places, message_index_length=len(indices),
                compression=chunk.compression, compressed_size=len(chunk.data),
                uncompressed_size=chunk.uncompressed_size,
            )
        )  # fmt: skip
        for channel, entry in entries.items():
            self._counts[channel] = self._counts.get(channel, 0) + len(entry) // 2

    def write_attachment(self, name: str, media_type: str, data: bytes) -> None:
        """Write a file that belongs to the recording."""
        start = self._file.tell()
        packed = _packed(Attachment(0, 0, name, media_type, data))
        self._write(packed)
        self._attachments.append(
            AttachmentIndex(start, len(packed), 0, 0, len(data), name, media_type)
        )

    def write_metadata(self, name: str, values: dict[str, str]) -> None:
        """Write a table of metadata."""
        start, packed = self._file.tell(), _packed(Metadata(name=name, metadata=values))
        self._write(packed)
        self._metadata.append(MetadataIndex(offset=start, length=len(packed), name=name))

    def finish(self) -> None:
        """Write the open chunk and the summary, by which readers find what they look for."""
        self.end_chunk()
        self._write(_packed(DataEnd(self._crc)))
        start = self._file.tell()
        groups: list[tuple[Opcode, list[McapRecord]]] = [
            (Opcode.SCHEMA, [*self._schemas]),
            (Opcode.CHANNEL, [*self._channels]),
            (Opcode.STATISTICS, [self._statistics()]),
            (Opcode.CHUNK_INDEX, [*self._chunks]),
            (Opcode.ATTACHMENT_INDEX, [*self._attachments]),
            (Opcode.METADATA_INDEX, [*self._metadata]),
        ]
        summary, offsets = b"", []
        for opcode, records in groups:
            packed = _packed(*records)
            offsets.append(SummaryOffset(opcode, start + len(summary), len(packed)))
            summary += packed
        offsets_start = start + len(summary)
        summary += _packed(*offsets)
        head = _FOOTER.pack(Opcode.FOOTER, _FOOTER.size - 9 + 4, start, offsets_start)
        self._write(summary)
        crc = zlib.crc32(head, zlib.crc32(summary))
        self._write(_packed(Footer(start, offsets_start, crc)) + MCAP0_MAGIC)

    def _statistics(self) -> Statistics:
        return Statistics(
            attachment_count=len(self._attachments),
            channel_count=len(self._channels),
            channel_message_counts=self._counts,
            chunk_count=len(self._chunks),
            message_count=sum(self._counts.values()),
            metadata_count=len(self._metadata),
            message_start_time=min((each.message_start_time for each in self._chunks), default=0),
            message_end_time=max((each.message_end_time for each in self._chunks), default=0),
            schema_count=len(self._schemas),
        )

    def _add(self, packed: bytes) -> None:
        self._parts.append(packed)
        self._size += len(packed)

    def _write(self, data: bytes) -> None:
        self._crc = zlib.crc32(data, self._crc)
        self._file.write(data)


def _packed(*records: McapRecord) -> bytes:
    builder: Any = RecordBuilder()
    for record in records:
        record.write(builder)
    return bytes(builder.end())


def _indices(entries: dict[int, list[int]], start: int) -> tuple[dict[int, int], bytes]:
    """The indices of a chunk that begin at a byte of the file: the place of each, and all."""
    places, parts, place = {}, [], start
    for channel, numbers in entries.items():
        size = len(numbers) // 2 * _ENTRY_BYTES
        head = _INDEX.pack(Opcode.MESSAGE_INDEX, _INDEX_BYTES + size, channel, size)
        places[channel] = place
        parts += [head, struct.pack(f"<{len(numbers)}Q", *numbers)]
        place += len(head) + size
    return places, b"".join(parts)
