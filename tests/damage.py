"""Damage to recordings."""

from __future__ import annotations

from pathlib import Path

from mcap.reader import make_reader


def damage_at(file: Path, time_ns: int) -> None:
    """Change a byte of the chunk with the messages of an instant."""
    with file.open("rb") as stream:
        summary = make_reader(stream).get_summary()
    assert summary is not None
    (chunk,) = [
        each
        for each in summary.chunk_indexes
        if each.message_start_time < time_ns < each.message_end_time
    ]
    changed = bytearray(file.read_bytes())
    changed[chunk.chunk_start_offset + chunk.chunk_length // 2] ^= 16
    file.write_bytes(changed)
