"""Metadata for a recording that its recorder has finished, or was killed over."""

from __future__ import annotations

import struct
import zlib
from pathlib import Path
from typing import IO

from mcap.data_stream import ReadDataStream, RecordBuilder
from mcap.opcode import Opcode
from mcap.records import DataEnd, Footer, McapRecord, Metadata, MetadataIndex

from bus_schema.recording.checked_records import HEAD, MAGIC, CheckedRecords

_DATA_END_BYTES = HEAD.size + 4
_FOOTER_BYTES = HEAD.size + 20
_METADATA_COUNT = struct.Struct("<I")
_COUNT_AT = HEAD.size + 18
"""Where the count of metadata is in the statistics of a file."""


def append_metadata(path: Path, name: str, values: dict[str, str]) -> None:
    """Add a table of metadata behind all that was recorded; a damaged recording stays as it is.

    Raises:
        OSError: the file is not there, or the disk does not take it.
    """
    size, record = path.stat().st_size, _bytes(Metadata(name=name, metadata=values))
    with path.open("r+b") as file:
        records = CheckedRecords(file, size)
        for _ in records:
            pass
        if records.damage:
            return
        at, tail = records.cut_off_at or 0, record
        if records.is_finished:
            at, tail = _tail_with(record, name, file, size - len(MAGIC) - _FOOTER_BYTES)
        file.seek(at)
        file.write(tail)
        file.truncate()


def _tail_with(record: bytes, name: str, file: IO[bytes], footer_at: int) -> tuple[int, bytes]:
    """Where the data of a finished file end, and what comes there: the record and a new summary.

    Offsets of the summary's parts, which readers can do without, are left out.
    """
    file.seek(footer_at + HEAD.size)
    footer = Footer.read(ReadDataStream(file))
    at = footer.summary_start - _DATA_END_BYTES
    file.seek(at + HEAD.size)
    data_crc = DataEnd.read(ReadDataStream(file)).data_section_crc
    end_data = _bytes(DataEnd(zlib.crc32(record, data_crc) if data_crc else 0))
    summary_end = footer.summary_offset_start or footer_at
    summary = bytearray(file.read(summary_end - footer.summary_start))
    place = 0
    while place < len(summary):
        opcode, length = HEAD.unpack_from(summary, place)
        if opcode == Opcode.STATISTICS:
            (count,) = _METADATA_COUNT.unpack_from(summary, place + _COUNT_AT)
            _METADATA_COUNT.pack_into(summary, place + _COUNT_AT, count + 1)
        place += HEAD.size + length
    summary += _bytes(MetadataIndex(at, len(record), name))
    summary += _bytes(Footer(footer.summary_start + len(record), 0, 0))[: -_METADATA_COUNT.size]
    checksum = struct.pack("<I", zlib.crc32(summary))
    return at, record + end_data + summary + checksum + MAGIC


def _bytes(record: McapRecord) -> bytes:
    builder = RecordBuilder()
    record.write(builder)
    return bytes(builder.end())  # type: ignore[no-untyped-call]
