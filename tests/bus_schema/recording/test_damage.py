"""Damaged recordings are reported, and read as far as possible."""

from __future__ import annotations

import struct

import numpy as np
import pytest
from mcap.opcode import Opcode
from mcap.records import Chunk
from mcap.stream_reader import StreamReader
from mcap.writer import CompressionType, Writer

from bus_schema.messages.topics import JOINT_COMMANDS, JOINT_STATES
from bus_schema.messages.types import JOINT_STATE, schema_text
from bus_schema.recording.mcap_log import McapLog, read_log

COUNT = 30


@pytest.fixture
def recording(tmp_path):
    """A recording of a few chunks; its path, its bytes, and what was written of each topic."""
    path = tmp_path / "run.mcap"
    random = np.random.default_rng(3)
    log = McapLog(path, bytes_per_s=0)
    log.attach("scenario.yaml", "application/yaml", b"name: x\n")
    log.add_metadata("run", {"clock": "lockstep"})
    written = {topic.name: [random.bytes(90) for _ in range(COUNT)] for topic in (JOINT_STATES,)}
    for index, payload in enumerate(written["joint_states"]):
        log.write(JOINT_STATES, index + 1, index, index, payload)
    log.close()
    return path, path.read_bytes(), written


def chunk_ranges(path):
    """Where the compressed messages of each chunk are in the file."""
    ranges = []
    with path.open("rb") as file:
        for record in StreamReader(file, emit_chunks=True).records:
            if isinstance(record, Chunk):
                ranges.append(range(file.tell() - len(record.data), file.tell()))
    return ranges


def chunk_starts(path):
    return [each.start for each in chunk_ranges(path)]


def test_no_byte_can_change_unnoticed(recording):
    """One byte in three; of a chunk, of which one checksum guards all, one in eleven."""
    path, whole, _ = recording
    assert read_log(path).complete
    chunks = chunk_ranges(path)
    assert len(chunks) > 3
    inside = {place for each in chunks for place in each[8:-8] if place % 11}
    for place in sorted(set(range(len(whole))) - inside)[::3]:
        changed = bytearray(whole)
        changed[place] ^= 1 << place % 8
        path.write_bytes(changed)
        contents = read_log(path)
        assert not contents.complete, place
        assert contents.damage, place


def test_a_damaged_chunk_costs_no_other(recording):
    path, whole, written = recording
    starts = chunk_starts(path)
    changed = bytearray(whole)
    changed[starts[1] + 200] ^= 4
    path.write_bytes(changed)
    contents = read_log(path)
    kept = contents.payloads["joint_states"]
    assert COUNT * 0.6 < len(kept) < COUNT
    assert kept == [each for each in written["joint_states"] if each in kept]
    assert kept[-1] == written["joint_states"][-1]
    assert "the chunk at byte" in contents.damage[0]
    assert contents.damage[-1] == f"{len(kept)} of {COUNT} messages could be read"
    assert contents.attachments == {"scenario.yaml": b"name: x\n"}


def test_topics_are_known_although_the_chunk_that_names_them_is_damaged(recording):
    path, whole, written = recording
    changed = bytearray(whole)
    changed[chunk_starts(path)[0] + 50] ^= 1
    path.write_bytes(changed)
    kept = read_log(path).payloads["joint_states"]
    assert COUNT * 0.6 < len(kept) < COUNT
    assert kept == written["joint_states"][-len(kept) :]


def test_a_file_that_lacks_its_end_is_damaged_unless_its_name_says_so(recording):
    path, whole, _ = recording
    for cut in (0, 5, len(whole) // 2, len(whole) - 1):
        for name, reported in (("run.mcap", True), ("run.partial.mcap", False)):
            file = path.with_name(name)
            file.write_bytes(whole[:cut])
            contents = read_log(file)
            assert not contents.complete
            assert bool(contents.damage) == reported, (cut, name)


def test_a_damaged_attachment_is_left_out(recording):
    path, whole, _ = recording
    path.write_bytes(whole.replace(b"name: x\n", b"name: y\n"))
    contents = read_log(path)
    assert not contents.attachments
    assert "the attachment at byte" in contents.damage[0]


def test_a_recording_without_checksums_over_its_data_says_so(tmp_path):
    path = tmp_path / "run.mcap"
    with path.open("wb") as file:  # as older versions wrote them
        writer = Writer(file, compression=CompressionType.ZSTD)
        writer.start(profile="ros2", library="funnel-hil")
        schema = writer.register_schema(JOINT_STATE, "ros2msg", schema_text(JOINT_STATE).encode())
        channel = writer.register_channel(f"/{JOINT_COMMANDS.name}", "cdr", schema)
        writer.add_message(channel, 1, b"payload", 1)
        writer.finish()
    contents = read_log(path)
    assert contents.complete
    assert contents.lacks_checksums
    assert contents.payloads == {"joint_commands": [b"payload"]}


@pytest.mark.parametrize("length", [0, 5, 21, 23, 31])
def test_message_of_a_wrong_length_is_damage_without_a_checksum(tmp_path, length):
    """In a chunk without a checksum, lengths alone say where a record ends."""
    path = tmp_path / "run.mcap"
    with path.open("wb") as file:
        writer = Writer(file, compression=CompressionType.NONE, enable_crcs=False)
        writer.start(profile="ros2", library="funnel-hil")
        schema = writer.register_schema(JOINT_STATE, "ros2msg", schema_text(JOINT_STATE).encode())
        channel = writer.register_channel(f"/{JOINT_COMMANDS.name}", "cdr", schema)
        writer.add_message(channel, 1, b"payload", 1)
        writer.finish()
    whole, right = path.read_bytes(), struct.pack("<BQH", Opcode.MESSAGE, 22 + 7, channel)
    assert whole.count(right) == 1
    assert read_log(path).payloads == {"joint_commands": [b"payload"]}
    path.write_bytes(whole.replace(right, struct.pack("<BQH", Opcode.MESSAGE, length, channel)))
    contents = read_log(path)
    assert "the chunk at byte" in contents.damage[0]
    assert not contents.complete
    assert not contents.payloads


def test_a_sparse_file_is_no_recording_and_is_not_read_to_its_end(tmp_path):
    path = tmp_path / "run.mcap"
    with path.open("wb") as file:
        file.write(b"\x89MCAP0\r\n")
        file.truncate(3 << 30)
    assert read_log(path).damage[0] == f"it cannot be read from byte 8 of {3 << 30} on"
