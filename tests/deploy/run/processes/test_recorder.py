"""The recorder counts what it did not get, by the numbers that each sender gave its messages."""

from __future__ import annotations

import json
import threading
from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from mcap.reader import make_reader

from bus_schema.messages.run_event import COMMANDS_RECEIVED, EventKind, RunEvent
from bus_schema.messages.topics import JOINT_COMMANDS, JOINT_STATES, RUN_EVENTS, TOPICS, Role, Topic
from bus_schema.recording.atomic_files import RecordFile
from bus_schema.recording.mcap_log import LogContents, read_log
from bus_schema.zenoh.access import bundle_key_expression
from bus_schema.zenoh.bundles import HEAD, Span
from bus_schema.zenoh.ros_graph import Attachment, node_token, node_tokens
from bus_schema.zenoh.session import ZenohSession
from deploy.run.processes import recorder as recorder_module
from deploy.run.processes.recorder import EventBudget, GapCounter, PlantSenders, Recorder
from deploy.scenario.scenario import load_setup
from deploy.scenario.setup import Setup
from tests.bus_schema.zenoh.zenoh_pair import HANG_S, state
from tests.waiting import await_true, free_endpoint

OURS, FOREIGN = b"o" * 16, b"f" * 16


class Bench:
    """A recorder at work, and a session that speaks as the plant."""

    def __init__(self, setup: Setup, path: Path) -> None:
        self.path = path
        self.session = ZenohSession([setup.scenario.link.plant_endpoint], [], low_latency=True)
        self.session.announce(node_token(0, self.session.identifier, "funnel_hil_plant"))
        recorder_is_there = threading.Event()
        self.session.watch_tokens(
            node_tokens(0, Role.RECORDER), lambda _token, _alive: recorder_is_there.set()
        )
        self.recorder = Recorder(setup, path)
        self._publishers = {
            topic.name: self.session.publisher(topic.key_expression(0))
            for topic in (JOINT_STATES, JOINT_COMMANDS, RUN_EVENTS)
        }
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self.recorder.run, args=(self._stop.is_set,))
        self._thread.start()
        assert recorder_is_there.wait(HANG_S)

    def send(self, topic: Topic, payload: bytes, attachment: bytes) -> None:
        self._publishers[topic.name].put(payload, attachment)

    def await_messages(self, count: int) -> None:
        await_true(lambda: self.received >= count)

    @property
    def received(self) -> int:
        """Messages in the recording but those that the recorder makes for viewers."""
        return sum(self.recorder._log.written[topic.name] for topic in TOPICS)

    def leave(self) -> LogContents:
        """The plant leaves; the recorder ends of itself."""
        self.session.close()
        self._thread.join(HANG_S)
        assert not self._thread.is_alive()
        self.recorder.close()
        return read_log(self.path)

    def give_up(self) -> None:
        self._stop.set()
        self._thread.join(HANG_S)
        self.session.close()


@pytest.fixture
def begin(tmp_path: Path) -> Iterator[Callable[..., Bench]]:
    """A function that starts a recorder with some settings."""
    benches = []

    def start(*settings: str) -> Bench:
        endpoints = [f"link.{role}_endpoint={free_endpoint()}" for role in ("plant", "controller")]
        benches.append(
            Bench(load_setup("paper_arm", [*settings, *endpoints]), tmp_path / "run.mcap")
        )
        return benches[-1]

    yield start
    for bench in benches:
        bench.give_up()


@pytest.fixture
def bench(begin: Callable[..., Bench]) -> Bench:
    return begin()


def number(sequence: int, gid: bytes = OURS, source_time_ns: int = 0) -> bytes:
    return Attachment(sequence, source_time_ns, gid).encode()


def test_gaps_in_the_numbers_of_each_sender_are_losses(bench: Bench) -> None:
    sent = [
        *((JOINT_STATES, sequence, OURS) for sequence in (1, 2, 5, 6, 10)),  # 3 4 7 8 9 missing
        *((JOINT_COMMANDS, sequence, OURS) for sequence in (1, 2, 3)),  # counted for itself
        *((JOINT_STATES, sequence, FOREIGN) for sequence in (1, 3)),  # 2 missing
        (JOINT_STATES, 10, OURS),  # once more: no loss, and no gain
        (JOINT_STATES, 9, OURS),  # late
        (JOINT_STATES, 11, OURS),
    ]
    for topic, sequence, gid in sent:
        bench.send(topic, state(sequence), number(sequence, gid))
    bench.await_messages(len(sent))
    log = bench.leave()
    assert bench.recorder.lost == {"joint_states": 5 + 1}
    assert bench.received == len(sent)
    assert log.metadata["recorder"] == {"messages": str(bench.recorder.messages), "lost": "6"}
    assert log.metadata["lost"] == {"joint_states": "6"}
    # Of what only a plant sends: two from another sender, and two that had come.
    assert log.metadata["rejected"] == {"second_plant": "4"}
    assert log.sequences["joint_states"] == [1, 2, 5, 6, 10, 1, 3, 10, 9, 11]
    assert log.complete


def test_first_messages_that_never_came_are_losses_too(bench: Bench) -> None:
    bench.send(JOINT_STATES, state(0), number(4))
    bench.await_messages(1)
    assert bench.recorder.lost == {"joint_states": 3}


def test_message_without_a_number_is_recorded_and_counts_as_no_loss(bench: Bench) -> None:
    for attachment in (b"", b"not an attachment", number(0)):
        bench.send(JOINT_STATES, state(0), attachment)
    bench.await_messages(3)
    log = bench.leave()
    assert bench.recorder.lost == {}
    assert log.sequences["joint_states"] == [0, 0, 0]


def test_what_waits_for_a_bundle_that_never_comes_is_recorded_in_the_end(bench: Bench) -> None:
    bundles = bench.session.publisher(bundle_key_expression(0, Role.PLANT))

    def send(bundle: int, sequence: int) -> None:
        """It is not kept: requests get no answer."""
        name, attachment, payload = b"joint_states", number(sequence), state(sequence)
        head = HEAD.pack(len(name), len(attachment), len(payload))
        bundles.put(head + name + attachment + payload, Span(1, bundle, OURS).encode())

    send(1, sequence=1)
    bench.await_messages(1)
    send(4, sequence=5)
    send(3, sequence=4)
    log = bench.leave()
    assert log.sequences["joint_states"] == [1, 4, 5]
    assert bench.recorder.lost == {"joint_states": 2}


def test_made_up_ids_fill_no_memory(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(recorder_module, "_MOST_STREAMS", 2)
    gaps = GapCounter(Counter())
    for sender, sequence in ((b"1", 1), (b"2", 1), (b"3", 5), (b"4", 7), (b"2", 3)):
        gaps.note("joint_states", sender, sequence)
    assert gaps.missed == {"joint_states": 1}
    assert len(gaps._last_sequence) == 2


def test_forged_number_is_no_loss() -> None:
    rejected: Counter[str] = Counter()
    gaps = GapCounter(rejected)
    for sequence in (1, 2, 2**55, 3, 5):
        gaps.note("run_events", b"plant", sequence)
    gaps.note("run_events", b"began long ago", 2**55)
    assert (gaps.missed, rejected) == ({"run_events": 1}, {"forged_number": 2})


def test_flood_of_run_events_is_left_out_and_takes_no_place_of_others() -> None:
    events = EventBudget()
    assert sum(events.admits(b"stranger", 100) for _ in range(100_000)) == 5000
    assert sum(events.admits(b"verbose", 1 << 18) for _ in range(100)) == 4
    assert events.admits(b"plant", 100)


@pytest.mark.parametrize("gid", [b"", FOREIGN], ids=["without numbers", "numbered"])
def test_commands_that_the_plant_received_and_that_never_came_are_losses(bench, gid):
    for sequence in (1, 2, 5):
        attachment = number(sequence, gid) if gid else b""
        bench.send(JOINT_COMMANDS, state(sequence), attachment)
    text = json.dumps({COMMANDS_RECEIVED: 3003})
    counts = RunEvent(0, Role.PLANT, EventKind.COUNTS, text).encode()
    bench.send(RUN_EVENTS, counts, number(1))
    bench.await_messages(4)
    log = bench.leave()
    assert bench.recorder.lost == {"joint_commands": 3000}
    assert log.metadata["lost"] == {"joint_commands": "3000"}


@pytest.mark.parametrize(("clock", "published_ns"), [("realtime", 123), ("lockstep", 7)])
def test_publish_time_is_on_the_runs_own_clock_in_virtual_time(begin, clock, published_ns):
    bench = begin(f"clock={clock}")
    bench.send(JOINT_STATES, state(7), number(1, source_time_ns=123))
    bench.await_messages(1)
    bench.leave()
    with bench.path.open("rb") as file:
        found = make_reader(file).iter_messages(topics=["/joint_states", "/tf"])
        times = [(message.log_time, message.publish_time) for _, _, message in found]
    assert times == [(7, published_ns)] * 2


def test_disk_that_hangs_holds_up_no_sender_and_costs_the_oldest(begin, monkeypatch):
    """In real time: the backlog is bounded, and what does not fit in is counted."""
    monkeypatch.setattr(recorder_module, "_LARGEST_BACKLOG_BYTES", 2_000_000)
    disk_works = threading.Event()
    disk_works.set()
    write = RecordFile.write

    def write_when_possible(file: RecordFile, data: bytes) -> int:
        assert disk_works.wait(HANG_S)
        return write(file, data)

    monkeypatch.setattr(RecordFile, "write", write_when_possible)
    bench = begin("clock=realtime")
    disk_works.clear()
    count, padding = 3000, bytes(20_000)  # 60 MB: more than all buffers on the way would hold
    for index in range(1, count + 1):
        bench.send(JOINT_STATES, state(index) + padding, number(index))
    disk_works.set()
    await_true(lambda: bench.received + bench.recorder.lost.total() == count)
    log = bench.leave()
    kept = log.sequences["joint_states"]
    assert log.complete
    assert kept[-1] == count
    assert bench.recorder.lost == {"joint_states": count - len(kept)}
    assert len(kept) < count // 2


@pytest.mark.parametrize("numbers", [(0, 1, 2, 3), (3,)])
def test_no_number_lets_a_stranger_start_the_plants_numbers_anew(numbers):
    rejected = Counter()
    senders = PlantSenders(rejected)
    for number in (1, 2, 3, *numbers):
        senders.note(JOINT_STATES.name, b"plant", number)
    assert rejected["second_plant"] == len(numbers)
