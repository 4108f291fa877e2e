"""Recordings of others are read with limits, and refused with file, size and limit."""

from __future__ import annotations

import resource
from pathlib import Path

import numpy as np
import pytest
from mcap.writer import CompressionType, Writer

from bus_schema.errors import InputError
from bus_schema.messages.types import JOINT_STATE, TYPESTORE, schema_text
from bus_schema.recording import checked_records
from bus_schema.runtime.limited_process import limited_memory
from deploy.measure import recordings
from deploy.measure.recordings import Recording

LARGE, MOST = 5_000, 1_000
MEGABYTE = 1_000_000


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


def write_bag(folder: Path, blob: bytes, mode: str | None = None) -> Path:
    from rosbags.rosbag2 import CompressionFormat, CompressionMode
    from rosbags.rosbag2 import Writer as BagWriter

    bag = BagWriter(folder, version=9)
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
    found = Recording(recording, MOST)
    messages = list(found.messages("/states"))
    assert [message.logged_ns for message in messages] == [0, 1, 2]
    assert [message.content.position.tolist() for message in messages] == [[0.5]] * 3
    assert found.topics == {"/states", "/blob"}
    assert len(list(Recording(recording, 2 * LARGE).messages(JOINT_STATE))) == 4
    assert list(Recording(recording).messages("/nowhere")) == []


@pytest.mark.parametrize("wanted", ["/blob", JOINT_STATE])
def test_too_large_message_is_refused_with_its_size_and_what_is_allowed(recording, wanted):
    with pytest.raises(InputError) as refused:
        list(Recording(recording, MOST).messages(wanted))
    size = len(joint_state("x" * LARGE)) / 1e6
    assert str(refused.value) == (
        f"{recording}: has a message of {size:.6g} MB on /blob, and messages of at most 0.001 MB"
        " are read"
    )


def test_too_many_messages_are_refused(recording, monkeypatch):
    monkeypatch.setattr(recordings, "MOST_MESSAGES", 2)
    with pytest.raises(InputError, match="more than 2 messages on /states, and at most these"):
        list(Recording(recording).messages("/states"))


@pytest.mark.parametrize("compression", list(CompressionType))
def test_chunk_is_refused_before_it_is_unpacked(compression, tmp_path, monkeypatch):
    """Zeros of any length are packed into a few bytes."""
    monkeypatch.setattr(checked_records, "_LARGEST_RECORD_BYTES", 100_000)
    file = write_mcap(tmp_path / "log.mcap", bytes(MEGABYTE), compression)
    with pytest.raises(InputError, match=r"log\.mcap: cannot be read as MCAP: the (chunk|record) at"
                       r" byte \d+ has 1\.\d+ MB, and at most 0\.1 MB are read"):  # fmt: skip
        list(Recording(file).messages("/states"))


def test_reader_that_takes_too_much_memory_is_ended_in_words(tmp_path):
    """A packed message may have any size."""
    folder = write_bag(tmp_path / "log", bytes(300 * MEGABYTE), "MESSAGE")
    limit = resource.getrlimit(resource.RLIMIT_AS)
    assert sum(file.stat().st_size for file in folder.iterdir()) < MEGABYTE
    with pytest.raises(InputError, match=r"log: takes more than the 100 MB that are allowed of"):
        list(Recording(folder, most_memory_bytes=100 * MEGABYTE).messages("/blob"))
    assert resource.getrlimit(resource.RLIMIT_AS) == limit


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
        list(Recording(tmp_path / name).messages("/states"))
