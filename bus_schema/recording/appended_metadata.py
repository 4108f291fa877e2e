"""Metadata for a recording that its recorder has finished, or was killed over."""

from __future__ import annotations

import zlib
from collections.abc import Iterator
from dataclasses import replace
from io import BytesIO
from pathlib import Path
from typing import IO

from mcap.data_stream import ReadDataStream, RecordBuilder
from mcap.opcode import Opcode
from mcap.records import (
    DataEnd,
    Footer,
    McapRecord,
    Metadata,
    MetadataIndex,
    Statistics,
    SummaryOffset,
)

from bus_schema.recording.checked_records import HEAD, MAGIC, CheckedRecords

_DATA_END_BYTES = HEAD.size + 4
_FOOTER_BYTES = HEAD.size + 20


def append_metadata(path: Path, name: str, values: dict[str, str]) -> None:
    """Add a table of metadata behind all that was recorded; a damaged recording stays as it is.

    Raises:
        OSError: the file is not there, or the disk does not take it.
    """
    size = path.stat().st_size
    with path.open("r+b") as file:
        records = CheckedRecords(file, size)
        for _ in records:
            pass
        if records.damage:
            return
        record = _bytes(Metadata(name=name, metadata=values))
        if records.is_finished:
            at, tail = _tail_with(record, name, file, size)
        else:
            at, tail = records.cut_off_at or 0, record
        file.seek(at)
        file.write(tail)
        file.truncate()


def _tail_with(record: bytes, name: str, file: IO[bytes], size: int) -> tuple[int, bytes]:
    """Where the data of a finished file end, and what comes there: the record and a new summary."""
    file.seek(size - len(MAGIC) - _FOOTER_BYTES + HEAD.size)
    footer = Footer.read(ReadDataStream(file))
    at = footer.summary_start - _DATA_END_BYTES
    file.seek(at + HEAD.size)
    data_crc = DataEnd.read(ReadDataStream(file)).data_section_crc
    summary = file.read(size - len(MAGIC) - _FOOTER_BYTES - footer.summary_start)
    start = at + len(record) + _DATA_END_BYTES
    content, offsets = b"", b""
    for opcode, group in _groups(summary, MetadataIndex(at, len(record), name)).items():
        place = SummaryOffset(opcode, start + len(content), len(group))
        content, offsets = content + group, offsets + _bytes(place)
    footer = Footer(start, start + len(content), 0)
    covered = content + offsets + _bytes(footer)[:-4]
    end = DataEnd(zlib.crc32(record, data_crc) if data_crc else 0)
    checked = _bytes(replace(footer, summary_crc=zlib.crc32(covered)))
    return at, record + _bytes(end) + content + offsets + checked + MAGIC


def _groups(summary: bytes, index: MetadataIndex) -> dict[int, bytes]:
    """The records of a summary by kind, with one more piece of metadata."""
    groups: dict[int, bytes] = {}
    for opcode, content in _records(summary):
        if opcode == Opcode.STATISTICS:
            counts = Statistics.read(ReadDataStream(BytesIO(content)))
            raw = _bytes(replace(counts, metadata_count=counts.metadata_count + 1))
        else:
            raw = HEAD.pack(opcode, len(content)) + content
        if opcode != Opcode.SUMMARY_OFFSET:
            groups[opcode] = groups.get(opcode, b"") + raw
    groups[Opcode.METADATA_INDEX] = groups.get(Opcode.METADATA_INDEX, b"") + _bytes(index)
    return groups


def _records(section: bytes) -> Iterator[tuple[int, bytes]]:
    at = 0
    while at < len(section):
        opcode, length = HEAD.unpack_from(section, at)
        yield opcode, section[at + HEAD.size : at + HEAD.size + length]
        at += HEAD.size + length


def _bytes(record: McapRecord) -> bytes:
    builder = RecordBuilder()
    record.write(builder)
    return bytes(builder.end())  # type: ignore[no-untyped-call]
