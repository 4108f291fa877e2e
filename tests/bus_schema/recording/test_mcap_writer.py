import io
import struct
import subprocess
import sys

import numpy as np
import pytest
from mcap.writer import CompressionType, Writer

from bus_schema.recording.mcap_writer import PlainWriter, QuickWriter

CHUNK_BYTES = 2000


def by_mcap(stream):
    return Writer(
        stream, chunk_size=CHUNK_BYTES, compression=CompressionType.ZSTD, enable_data_crcs=True
    )


def by_us(stream):
    return QuickWriter(stream, CHUNK_BYTES)


def by_public_means(stream):
    return PlainWriter(stream, CHUNK_BYTES)


def written(open_writer, messages, files):
    stream = io.BytesIO()
    writer = open_writer(stream)
    writer.start(profile="ros2", library="funnel-hil")
    for name, data in files:
        writer.add_attachment(0, 0, name, "text/plain", data)
    for number in (1, 2):
        schema = writer.register_schema(f"pkg/msg/Type{number}", "ros2msg", b"float64 x")
        writer.register_channel(f"/topic_{number}", "cdr", schema, {"qos": "ü"})
    for message in messages:
        if writer.add_message(*message):  # mcap's own ends a full chunk itself
            writer.flush()
    writer.add_metadata("run", {"law": "pid", "empty": ""})
    writer.flush()
    writer.finish()
    return stream.getvalue()


@pytest.mark.parametrize("count", [0, 1, 2, 500])
@pytest.mark.parametrize("files", [[], [("a.yaml", b"name: x\n"), ("empty", b"")]])
def test_the_file_is_byte_for_byte_what_mcap_writes(count, files):
    """Times that go back, channels in any order, payloads of any size: none, or a chunk's."""
    random = np.random.default_rng(count)
    sizes = random.choice([0, 1, 96, CHUNK_BYTES], count)
    messages = [
        (
            int(random.integers(1, 3)), int(random.integers(1, 2**62)), random.bytes(size),
            int(random.integers(2**62)), int(random.integers(2**32)),
        )
        for size in sizes
    ]  # fmt: skip
    assert written(by_us, messages, files) == written(by_mcap, messages, files)


def test_a_number_without_room_leaves_the_chunk_as_it_was():
    stream = io.BytesIO()
    writer = QuickWriter(stream, CHUNK_BYTES)
    writer.register_channel("/topic", "cdr", 0, {})
    with pytest.raises(struct.error):
        writer.add_message(1, -1, b"payload", 0, 0)
    before = len(stream.getvalue())
    writer.flush()
    assert len(stream.getvalue()) == before


CONTENTS = """
import sys
from pathlib import Path
from bus_schema.messages.topics import TOPICS
from bus_schema.recording.mcap_log import McapLog, read_log
from bus_schema.recording.mcap_writer import can_be_quick

log = McapLog(Path(sys.argv[1]), bytes_per_s=8000)
for number in range(200):
    log.write(TOPICS[number % 2], number, number, number, bytes([number]) * 50)
log.attach("scenario.yaml", "text/yaml", b"name: x")
counts = log.written
log.close()
contents = read_log(Path(sys.argv[1]))
assert contents.complete and not contents.damage and log.written == counts
print(can_be_quick(), file=sys.stderr)
print(sorted(counts.items()), contents.payloads, contents.sequences, contents.attachments)
"""
TAKEN_AWAY = {
    "the module of chunks": "import mcap.writer, sys; sys.modules['mcap._chunk_builder'] = None",
    "the writer's chunk": (
        "import inspect, mcap.writer as own;"
        "exec(inspect.getsource(own).replace('__chunk_builder', '__chunk'), vars(own))"
    ),
}


def test_without_what_mcap_keeps_to_itself_a_recording_reads_back_the_same(tmp_path):
    def contents(preamble):
        words = [sys.executable, "-c", preamble + CONTENTS, tmp_path / "run.mcap"]
        done = subprocess.run(words, capture_output=True, text=True, check=True)
        return done.stderr.strip(), done.stdout

    is_quick, before = contents("")
    assert is_quick == "True"
    for preamble in TAKEN_AWAY.values():
        assert contents(preamble) == ("False", before)


def test_public_means_write_the_same_file():
    messages = [(1 + number % 2, number, b"data", number, number) for number in range(9)]
    assert written(by_public_means, messages, []) == written(by_us, messages, [])
