import errno
import resource
from contextlib import contextmanager

import numpy as np
import yaml
from mcap.reader import make_reader
from mcap.records import Chunk, Message
from mcap.stream_reader import StreamReader, breakup_chunk
from mcap_ros2.decoder import DecoderFactory

from bus_schema.messages.record import Record
from bus_schema.messages.run_event import EventKind, RunEvent
from bus_schema.messages.topics import CONTROL_STATUS, JOINT_STATES, RUN_EVENTS, TOPICS, layout
from bus_schema.recording import mcap_log
from bus_schema.recording.atomic_files import partial_path
from bus_schema.recording.mcap_log import McapLog, read_log

JOINTS = ("yaw", "shoulder", "elbow")
PAYLOAD_BYTES = 96
# A message record has 31 bytes beside its payload, and a chunk closes when it passes 1024 bytes.
# The first chunk of a file also holds schema and channel.
MESSAGES_PER_CHUNK = 1024 // (31 + PAYLOAD_BYTES) + 1


def payload_of(topic, seed):
    if topic is RUN_EVENTS:
        return RunEvent(seed, "plant", EventKind.STARTED, "für 3 s").encode()
    record = Record(layout(topic, JOINTS))
    random = np.random.default_rng(seed)
    for name, values in record.fields.items():
        values[:] = random.integers(0, 2 if values.dtype == np.uint8 else 100, values.shape)
        assert name in record.fields
    return record.payload()


def write_noise(log, count):
    """Incompressible payloads on one topic, numbered from 1."""
    random = np.random.default_rng(2)
    payloads = [random.bytes(PAYLOAD_BYTES) for _ in range(count)]
    for index, payload in enumerate(payloads):
        log.write(JOINT_STATES, index + 1, index, index, payload)
    return payloads


def test_what_is_written_is_read_back_bit_for_bit(tmp_path):
    path = tmp_path / "run.mcap"
    log = McapLog(path, bytes_per_s=1e6)
    written = {topic.name: [payload_of(topic, seed) for seed in range(20)] for topic in TOPICS}
    for seed in range(20):
        for topic in TOPICS:
            log.write(topic, 2**32 + seed, 10**9 * seed, 5, written[topic.name][seed])
    log.attach("scenario.yaml", "application/yaml", b"name: x\n\xff")
    log.attach("empty", "text/plain", b"")
    log.add_metadata("run", {"seed": "1", "law": "pid"})
    log.close()

    contents = read_log(path)
    assert log.messages == 20 * len(TOPICS)
    assert contents.complete
    assert contents.payloads == written
    assert contents.sequences["joint_states"] == list(range(20))  # modulo 2³², as MCAP has it
    assert contents.attachments == {"scenario.yaml": b"name: x\n\xff", "empty": b""}
    assert contents.metadata == {"run": {"seed": "1", "law": "pid"}}


def test_foreign_ros2_tools_decode_every_topic(tmp_path):
    path = tmp_path / "run.mcap"
    log = McapLog(path, bytes_per_s=0)
    for topic in TOPICS:
        log.write(topic, 1, 7, 8, payload_of(topic, seed=4))
    log.close()
    decoded = {}
    with path.open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        assert reader.get_header().profile == "ros2"
        for schema, channel, message, values in reader.iter_decoded_messages():
            assert (schema.encoding, channel.message_encoding) == ("ros2msg", "cdr")
            assert (message.log_time, message.publish_time, message.sequence) == (7, 8, 1)
            (qos,) = yaml.safe_load(channel.metadata["offered_qos_profiles"])
            assert (qos["history"], qos["depth"]) == ("keep_last", 10)
            assert qos["reliability"] == "reliable"
            decoded[channel.topic] = values
    assert set(decoded) == {f"/{topic.name}" for topic in TOPICS}
    assert decoded["/run_events"].detail == "für 3 s"
    for topic in TOPICS:
        if topic is not RUN_EVENTS:
            record = Record(layout(topic, JOINTS))
            record.memory[:] = payload_of(topic, seed=4)
            for name, expected in record.fields.items():
                value = decoded[f"/{topic.name}"]
                for part in name.split("."):
                    value = getattr(value, part)
                np.testing.assert_array_equal(np.atleast_1d(value), expected, err_msg=name)


def test_file_cut_anywhere_loses_at_most_the_chunk_that_was_cut(tmp_path):
    path = tmp_path / "run.mcap"
    log = McapLog(path, bytes_per_s=0)
    written = write_noise(log, 10 * MESSAGES_PER_CHUNK)
    log.close()
    whole = path.read_bytes()
    # Where each chunk ends in the file, and how many messages are safe from there on.
    safe = [(0, 0)]
    with path.open("rb") as file:
        for record in StreamReader(file, emit_chunks=True).records:
            if isinstance(record, Chunk):
                held = sum(isinstance(inner, Message) for inner in breakup_chunk(record))
                assert held <= MESSAGES_PER_CHUNK
                safe.append((file.tell(), safe[-1][1] + held))
    assert safe[-1][1] == len(written)
    assert len(safe) > 10

    cuts = {*range(40), *range(0, len(whole), 37), *range(len(whole) - 40, len(whole))}
    cuts |= {end + shift for end, _ in safe[1:] for shift in range(-12, 12)}
    for cut in sorted(cuts):
        path.write_bytes(whole[:cut])
        contents = read_log(path)
        expected = max(count for end, count in safe if end <= cut)
        assert contents.payloads["joint_states"] == written[:expected], cut
        assert contents.sequences["joint_states"] == list(range(1, expected + 1)), cut
        assert not contents.complete, cut


def test_chunks_hold_a_quarter_second_of_the_expected_rate(tmp_path):
    path = tmp_path / "run.mcap"
    log = McapLog(path, bytes_per_s=64_000)
    write_noise(log, 1000)
    log.close()
    sizes = []
    with path.open("rb") as file:
        for record in StreamReader(file, emit_chunks=True).records:
            if isinstance(record, Chunk):
                sizes.append(record.uncompressed_size)
    assert all(16_000 < size <= 16_000 + 31 + PAYLOAD_BYTES for size in sizes[:-1])
    assert len(sizes) == 8  # 1000 × 127 bytes in chunks of 16,000


@contextmanager
def largest_file(size):
    """No file may grow beyond this; the kernel refuses as it does on a full disk."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)


def test_disk_that_is_full_ends_the_recording_and_all_is_accounted_for(tmp_path):
    path, count = tmp_path / "run.mcap", 3000
    with largest_file(128 * 1024):
        log = McapLog(path, bytes_per_s=0)
        log.write(RUN_EVENTS, 1, 0, 0, b"first")
        written = write_noise(log, count)
        log.finish_messages()
        assert log.failure.errno == errno.EFBIG
        log.close()
    assert not path.exists()
    contents = read_log(partial_path(path))
    kept = contents.payloads["joint_states"]
    assert not contents.complete
    assert 0 < len(kept) < count
    assert kept == written[: len(kept)]
    assert log.messages == len(kept) + 1
    assert log.lost == {"joint_states": count - len(kept)}


def test_file_lists_its_losses_even_on_a_full_disk(small_disk):
    """A reserve is kept free for it, and given back in the end."""
    path = small_disk / "run.mcap"
    log = McapLog(path, bytes_per_s=0)
    write_noise(log, 6000)  # 0.7 MB on half a megabyte
    assert log.failure.errno == errno.ENOSPC
    log.finish_messages()
    log.add_metadata("lost", {"joint_states": str(log.lost["joint_states"])})
    log.close()
    contents = read_log(partial_path(path))
    assert contents.metadata["lost"] == {"joint_states": str(6000 - log.messages)}
    assert len(contents.payloads["joint_states"]) == log.messages
    (small_disk / "summary.json").write_bytes(bytes(8192))  # there is room for that again


def test_messages_in_the_form_of_another_version_are_left_out(tmp_path, monkeypatch):
    ours = mcap_log.schema_text(CONTROL_STATUS.type_name)
    monkeypatch.setattr(mcap_log, "schema_text", lambda _: ours.replace("inertia_factor", "other"))
    log = McapLog(tmp_path / "run.mcap", bytes_per_s=1e6)
    log.write(CONTROL_STATUS, 1, 0, 0, payload_of(CONTROL_STATUS, 1))
    log.close()
    contents = read_log(tmp_path / "run.mcap")
    assert not contents.payloads
    assert not contents.complete
    assert contents.damage == [
        "its messages of funnel_hil_msgs/msg/ControlStatus are from another version of"
        " funnel-hil; that version can read them",
        "0 of 1 messages could be read",
    ]
