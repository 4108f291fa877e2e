"""Recordings of others are read with limits, and refused with file, size and limit."""

from __future__ import annotations

import resource
from contextlib import nullcontext
from pathlib import Path

import numpy as np
import pytest
from mcap.writer import CompressionType, Writer

from bus_schema.errors import InputError
from bus_schema.messages.types import JOINT_STATE, TYPESTORE, schema_text
from bus_schema.recording import checked_records
from bus_schema.runtime.limited_process import limited_memory
from deploy.measure import recordings
from deploy.measure.mcap_series import read_fields
from deploy.measure.recordings import opened

LARGE, MOST = 5_000, 1_000
MEGABYTE = 1_000_000
knows_its_memory = pytest.mark.skipif(
    not Path("/proc/self/statm").is_file(), reason="without /proc there is no limit"
)


def read(path, topic, *limits):
    with opened(path, *limits) as recording:
        return list(recording.messages(topic))


def joint_state(text: str = "") -> bytes:
    types = TYPESTORE.types
    header = types["std_msgs/msg/Header"](types["builtin_interfaces/msg/Time"](1, 0), text)
    none = np.zeros(0)
    message = types[JOINT_STATE](header, ["a"], np.array([0.5]), none, none)
    return bytes(TYPESTORE.serialize_cdr(message, JOINT_STATE))


def write_mcap(file: Path, blob: bytes, compression=CompressionType.ZSTD) -> Path:
    with file.open("wb") as stream:
        writer = Writer(stream, compression=compression)
        writer.start("ros2")
        schema = writer.register_schema(JOINT_STATE, "ros2msg", schema_text(JOINT_STATE).encode())
        for topic, payloads in (("/states", [joint_state()] * 3), ("/blob", [blob])):
            channel = writer.register_channel(topic, "cdr", schema)
            for time_ns, payload in enumerate(payloads):
                writer.add_message(channel, time_ns, payload, time_ns)
        writer.finish()
    return file


def write_bag(folder: Path, blob: bytes, mode: str | None = None, **options) -> Path:
    from rosbags.rosbag2 import CompressionFormat, CompressionMode
    from rosbags.rosbag2 import Writer as BagWriter

    bag = BagWriter(folder, version=9, **options)
    if mode is not None:
        bag.set_compression(CompressionMode[mode], CompressionFormat.ZSTD)
    with bag as writer:
        for topic, payloads in (("/states", [joint_state()] * 3), ("/blob", [blob])):
            connection = writer.add_connection(topic, JOINT_STATE, typestore=TYPESTORE)
            for time_ns, payload in enumerate(payloads):
                writer.write(connection, time_ns, payload)
    return folder


@pytest.fixture(params=["mcap", "bag", "database"])
def recording(request, tmp_path) -> Path:
    """Three joint states, and a large one on another topic."""
    blob = joint_state("x" * LARGE)
    if request.param == "mcap":
        return write_mcap(tmp_path / "log.mcap", blob)
    folder = write_bag(tmp_path / "log", blob)
    return folder if request.param == "bag" else next(folder.glob("*.db3"))


def test_messages_are_read_beside_larger_ones_of_other_topics(recording):
    with opened(recording, MOST) as found:
        messages = list(found.messages("/states"))
    assert [message.logged_ns for message in messages] == [0, 1, 2]
    assert [message.content.position.tolist() for message in messages] == [[0.5]] * 3
    assert found.topics == {"/states", "/blob"}
    assert len(read(recording, JOINT_STATE, 2 * LARGE)) == 4
    assert read(recording, "/nowhere") == []


@pytest.mark.parametrize("wanted", ["/blob", JOINT_STATE])
def test_too_large_message_is_refused_with_its_size_and_what_is_allowed(recording, wanted):
    with pytest.raises(InputError) as refused:
        read(recording, wanted, MOST)
    size = len(joint_state("x" * LARGE)) / 1e6
    assert str(refused.value) == (
        f"{recording}: has a message of {size:.6g} MB on /blob, and messages of at most 0.001 MB"
        " are read"
    )


def test_too_many_messages_are_refused(recording, monkeypatch):
    monkeypatch.setattr(recordings, "MOST_MESSAGES", 2)
    with pytest.raises(InputError, match="more than 2 messages on /states, and at most these"):
        read(recording, "/states")


@pytest.mark.parametrize("compression", list(CompressionType))
def test_chunk_is_refused_before_it_is_unpacked(compression, tmp_path, monkeypatch):
    """Zeros of any length are packed into a few bytes."""
    monkeypatch.setattr(checked_records, "_LARGEST_RECORD_BYTES", 100_000)
    file = write_mcap(tmp_path / "log.mcap", bytes(MEGABYTE), compression)
    with pytest.raises(InputError, match=r"log\.mcap: cannot be read as MCAP: the (chunk|record) at"
                       r" byte \d+ has 1\.\d+ MB, and at most 0\.1 MB are read"):  # fmt: skip
        read(file, "/states")


@knows_its_memory
def test_reader_that_takes_too_much_memory_is_ended_in_words(tmp_path):
    """A packed message may have any size."""
    folder = write_bag(tmp_path / "log", bytes(300 * MEGABYTE), "MESSAGE")
    limit = resource.getrlimit(resource.RLIMIT_AS)
    assert sum(file.stat().st_size for file in folder.iterdir()) < MEGABYTE
    with pytest.raises(InputError, match=r"log: takes more than the 100 MB that are allowed of"):
        read(folder, "/blob", 500 * MEGABYTE, 100 * MEGABYTE)
    assert resource.getrlimit(resource.RLIMIT_AS) == limit


@knows_its_memory
def test_memory_is_limited_within_a_context_alone():
    with limited_memory(50 * MEGABYTE):
        assert len(bytearray(MEGABYTE)) == MEGABYTE
        with pytest.raises(MemoryError):
            bytearray(200 * MEGABYTE)
    assert len(bytearray(200 * MEGABYTE)) == 200 * MEGABYTE


@pytest.mark.parametrize("name", ["log.mcap", "log.db3"])
def test_file_that_is_no_recording_is_refused_with_a_reason(name, tmp_path):
    (tmp_path / name).write_text("hello")
    with pytest.raises(InputError, match=rf"{name}: cannot be read as .*: \w+"):
        read(tmp_path / name, "/states")


def test_one_pass_reads_both_numbers(recording, monkeypatch):
    passes = []
    monkeypatch.setattr(recordings, "limited_memory", lambda _: passes.append(1) or nullcontext())
    one, other = read_fields(recording, "/states.position[0]", "/states.position[a]")
    assert one.values.tolist() == other.values.tolist() == [0.5] * 3
    assert len(passes) == 1


@knows_its_memory
def test_what_is_made_of_messages_counts_to_the_memory(recording):
    refused = pytest.raises(InputError, match="takes more than the 50 MB that are allowed of mem")
    with refused, opened(recording, MOST, 50 * MEGABYTE) as found:
        [bytearray(100 * MEGABYTE) for _ in found.messages("/states")]


def test_chunks_of_a_bag_with_mcap_are_checked_before_rosbags_unpacks_them(tmp_path, monkeypatch):
    from rosbags.rosbag2 import StoragePlugin

    monkeypatch.setattr(checked_records, "_LARGEST_RECORD_BYTES", 100_000)
    folder = write_bag(tmp_path / "log", bytes(MEGABYTE), storage_plugin=StoragePlugin.MCAP)
    with pytest.raises(InputError, match=r"log: cannot be read as a recording: the chunk at byte"
                       r" \d+ has 1\.\d+ MB, and at most 0\.1 MB are read"):  # fmt: skip
        read(folder, "/states")
    monkeypatch.undo()
    assert len(read(folder, "/states")) == 3
