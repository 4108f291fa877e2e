"""Records of an MCAP file, each checked against the checksums of the file.

The checksums cover every byte: one all data, one the summary with its footer; all other bytes, such
as the marks at both ends, are constants. Chunks and attachments have separate checksums, so damage
to one of them affects no other.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Callable, Iterator
from io import BytesIO
from typing import IO, Any, NamedTuple

import zstandard
from mcap import records
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.stream_reader import get_chunk_data_stream

MAGIC = b"\x89MCAP0\r\n"
HEAD = struct.Struct("<BQ")
_CRC = struct.Struct("<I")
_MESSAGE = struct.Struct("<HIQQ")
"""Head of a message: channel, sequence number, log time, publish time."""
_CHUNK_HEAD = struct.Struct("<QQQ")
"""Head of a chunk: times of its first and last message, size when unpacked."""
_FOOTER_BYTES = 8 + 8 + _CRC.size
_LARGEST_RECORD_BYTES = 1 << 28
"""Also of an unpacked chunk: many times what recorders write, and less than exhausts a memory."""
_DAMAGED = (
    McapError, EOFError, ValueError, LookupError, ArithmeticError, MemoryError, struct.error,
    zstandard.ZstdError,
)  # fmt: skip
"""Errors raised by reading damaged bytes, in which any length may occur."""

_PARSERS: dict[int, Callable[[ReadDataStream], Any]] = {
    Opcode.SCHEMA: records.Schema.read,
    Opcode.CHANNEL: records.Channel.read,
    Opcode.CHUNK: records.Chunk.read,
    Opcode.ATTACHMENT: records.Attachment.read,
    Opcode.METADATA: records.Metadata.read,
    Opcode.STATISTICS: records.Statistics.read,
}
_CALLED: dict[int, str] = {Opcode.CHUNK: "chunk", Opcode.ATTACHMENT: "attachment"}


class _TooLargeError(ValueError):
    """A chunk is too large."""


class _Raw(NamedTuple):
    """A raw record of the file; `crc` is the checksum of the section up to it."""

    start: int
    opcode: int
    content: bytes
    crc: int


class CheckedRecords:
    """Iterator over a file's records in order, with those of chunks one by one; usable once.

    Args:
        file: the file, at its beginning.
        size: its bytes.

    Attributes:
        damage: what is wrong with the file, one sentence per problem.
        cut_off_at: the byte from which nothing can be read; None if all could be read.
        is_finished: the file came to its proper end.
        lacks_checksums: no checksum covers all data, as in files of older or foreign recorders.
    """

    def __init__(self, file: IO[bytes], size: int) -> None:
        self._file, self._size = file, size
        self._position = self._crc = 0
        self._has_data_end = False
        self.damage: list[str] = []
        self.cut_off_at: int | None = None
        self.is_finished = False
        self.lacks_checksums = False

    def __iter__(self) -> Iterator[records.McapRecord]:
        if not MAGIC.startswith(self._take(len(MAGIC))):
            self.damage.append("it does not begin like an MCAP file")
        while (raw := self._next()) is not None:
            if raw.opcode == Opcode.DATA_END:
                self._end_data(raw)
            elif raw.opcode == Opcode.FOOTER:
                self._end_file(raw)
                return
            else:
                yield from self._parsed(raw)

    def _take(self, count: int) -> bytes:
        data = self._file.read(count)
        self._position += len(data)
        self._crc = zlib.crc32(data, self._crc)
        return data

    def _next(self) -> _Raw | None:
        """Return the next record; None if the rest of the file holds no whole one."""
        start, crc = self._position, self._crc
        if self._size - start >= HEAD.size:
            opcode, length = HEAD.unpack(self._take(HEAD.size))
            is_whole = opcode and length <= self._size - self._position
            if is_whole and length <= _LARGEST_RECORD_BYTES:
                return _Raw(start, opcode, self._take(length), crc)
            if is_whole:
                self.damage.append(f"the record at byte {start} {_too_large(length)}")
        self.cut_off_at = start
        return None

    def _parsed(self, raw: _Raw) -> list[records.McapRecord]:
        """Yield the records in a record: those of a chunk, itself, or none if it is not needed."""
        try:
            if raw.opcode == Opcode.MESSAGE:
                return [records.Message.read(_stream(raw.content), len(raw.content))]
            parse = _PARSERS.get(raw.opcode)
            if parse is None:
                return []
            if raw.opcode == Opcode.ATTACHMENT:
                _check(raw.content[-_CRC.size :], zlib.crc32(raw.content[: -_CRC.size]))
            record = parse(_stream(raw.content))
            return _inner_records(record) if isinstance(record, records.Chunk) else [record]
        except _DAMAGED as error:
            name = _CALLED.get(raw.opcode, "record")
            why = error if isinstance(error, _TooLargeError) else "cannot be read"
            self.damage.append(f"the {name} at byte {raw.start} {why}")
            return []

    def _end_data(self, raw: _Raw) -> None:
        self._has_data_end, self._crc = True, 0
        self._check_section(raw.content, raw.crc, "its data do not match their checksum")

    def _end_file(self, raw: _Raw) -> None:
        head = HEAD.pack(raw.opcode, len(raw.content))
        covered = zlib.crc32(head + raw.content[: -_CRC.size], raw.crc)
        if not self._has_data_end or len(raw.content) != _FOOTER_BYTES:
            self.damage.append("it does not end like an MCAP file")
        else:
            self._check_section(
                raw.content[-_CRC.size :], covered, "its summary does not match its checksum"
            )
        end, mark = self._position, self._take(len(MAGIC))
        self.is_finished = mark == MAGIC
        if not MAGIC.startswith(mark) or self._position != self._size:
            self.damage.append("other data follow its end")
        elif not self.is_finished:
            self.cut_off_at = end

    def _check_section(self, expected: bytes, actual: int, otherwise: str) -> None:
        self.lacks_checksums |= expected == bytes(_CRC.size)
        try:
            _check(expected, actual)
        except ValueError:
            self.damage.append(otherwise)


def check_sizes(file: IO[bytes], size: int) -> None:
    """Check the sizes of all records, and of all chunks once unpacked; nothing is unpacked.

    Args:
        file: an MCAP file.
        size: its bytes.

    Raises:
        ValueError: a record or chunk is too large.
    """
    place = len(MAGIC)
    while place + HEAD.size <= size:
        file.seek(place)
        opcode, length = HEAD.unpack(file.read(HEAD.size))
        head = file.read(_CHUNK_HEAD.size) if opcode == Opcode.CHUNK else b""
        unpacked = _CHUNK_HEAD.unpack(head)[-1] if len(head) == _CHUNK_HEAD.size else 0
        if max(length, unpacked) > _LARGEST_RECORD_BYTES:
            name = _CALLED.get(opcode, "record")
            raise _TooLargeError(f"the {name} at byte {place} {_too_large(max(length, unpacked))}")
        place += HEAD.size + length


def _too_large(size: int) -> str:
    return f"has {size / 1e6:.6g} MB, and at most {_LARGEST_RECORD_BYTES / 1e6:.6g} MB are read"


def _stream(content: bytes) -> ReadDataStream:
    return ReadDataStream(BytesIO(content))


def _check(expected: bytes, actual: int) -> None:
    """Compare a checksum; 0 means that there is none.

    Raises:
        ValueError: it differs.
    """
    if len(expected) != _CRC.size or _CRC.unpack(expected)[0] not in (0, actual):
        raise ValueError("wrong checksum")


def _inner_records(chunk: records.Chunk) -> list[records.McapRecord]:
    """Yield the records of a chunk, whose size is checked before memory is allocated for it."""
    size = chunk.uncompressed_size
    if chunk.compression == "zstd" and zstandard.frame_content_size(chunk.data) not in (-1, size):
        raise ValueError("the size that it has packed and unpacked")
    if size > _LARGEST_RECORD_BYTES:
        raise _TooLargeError(_too_large(size))
    stream, unpacked = get_chunk_data_stream(chunk, validate_crc=True)
    return list(_records_in(stream.read(unpacked)))


def _records_in(content: bytes) -> Iterator[records.McapRecord]:
    """Yield the records of an unpacked chunk, ten times as fast for messages as mcap's own reader.

    Raises:
        ValueError: its last record is incomplete, or a message is malformed.
    """
    place = 0
    while place < len(content):
        opcode, length = HEAD.unpack_from(content, place)
        start, place = place + HEAD.size, place + HEAD.size + length
        if place > len(content) or (opcode == Opcode.MESSAGE and length < _MESSAGE.size):
            raise ValueError("an incomplete record")
        if opcode == Opcode.MESSAGE:
            channel, sequence, log_ns, sent_ns = _MESSAGE.unpack_from(content, start)
            data = content[start + _MESSAGE.size : place]
            yield records.Message(channel, log_ns, data, sent_ns, sequence)
        elif opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
            yield _PARSERS[opcode](_stream(content[start:place]))
