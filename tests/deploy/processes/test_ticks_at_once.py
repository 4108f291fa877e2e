"""What a recorder makes of ticks that come at once is what it makes of their messages."""

from __future__ import annotations

import itertools
import random
import zlib
from collections import Counter
from collections.abc import Iterable
from pathlib import Path

import pytest
from mcap.reader import make_reader

from bus_schema.messages.topics import JOINT_COMMANDS, JOINT_STATES, TOPICS, Role, Topic, topics_of
from bus_schema.recording.mcap_log import read_log
from bus_schema.zenoh.bundled_ticks import Messages, Ticks, parts_of
from bus_schema.zenoh.bundles import HEAD
from bus_schema.zenoh.ros_graph import Attachment
from deploy.processes.recorder import GapCounter, Recorder
from deploy.runs.simulate import simulate
from deploy.scenario.scenario import load_setup
from deploy.scenario.setup import Setup
from tests.bus_schema.zenoh.zenoh_pair import free_endpoint

NAMES = {topic.name.encode(): topic for topic in TOPICS}
GIDS = {topic.name: bytes([place]) * 16 for place, topic in enumerate(TOPICS)}
TICKS_OF_A_BUNDLE, TICKS = 32, 400


def setup_of(clock: str) -> Setup:
    endpoints = [f"link.{role}_endpoint={free_endpoint()}" for role in ("plant", "controller")]
    return load_setup("paper_arm", [f"clock={clock}", f"duration_s={TICKS / 1000}", *endpoints])


def bundles_of(messages: Iterable[tuple[Topic, bytes]]) -> list[bytes]:
    """The messages of a run as both loops would bundle them."""
    numbers: Counter[str] = Counter()
    bundles: list[bytes] = []
    kept: dict[bool, list[bytes]] = {True: [], False: []}
    for topic, payload in messages:
        numbers[topic.name] += 1
        number, name = numbers[topic.name], topic.name.encode()
        attachment = Attachment(number, 10**9 + number, GIDS[topic.name]).encode()
        of_plant = topic is JOINT_COMMANDS or topic in topics_of(Role.PLANT)
        head = HEAD.pack(len(name), len(attachment), len(payload))
        kept[of_plant].append(head + name + attachment + payload)
        if numbers["control_status"] % TICKS_OF_A_BUNDLE == 0 and topic.name == "control_status":
            bundles += [b"".join(kept[True]), b"".join(kept[False])]
            kept = {True: [], False: []}
    return bundles + [b"".join(rest) for rest in kept.values()]


def spoilt(topic: Topic, payload: bytes) -> bytes:
    """Of joint states every other one, more or less, cannot be read: it has no picture."""
    is_readable = topic is not JOINT_STATES or zlib.crc32(payload) % 2
    return payload if is_readable else payload[:12] + b"\xff" * (len(payload) - 12)


def recorded(setup: Setup, path: Path, parts: Iterable[Messages]) -> Recorder:
    recorder = Recorder(setup, path)
    for part in parts:
        recorder._write(part)
    return recorder


@pytest.mark.parametrize("clock", ["lockstep", "realtime"])
@pytest.mark.parametrize("lacking", [None, 150], ids=["all", "one is missing"])
def test_recording_is_the_same(tmp_path: Path, clock: str, lacking: int | None) -> None:
    setup = setup_of(clock)
    run = simulate(setup)
    bundles = bundles_of(zip(run.topics, map(spoilt, run.topics, run.payloads), strict=True))
    parts = list(itertools.chain.from_iterable(parts_of(each, NAMES) for each in bundles))
    if lacking is not None:
        del parts[len(parts) // 2]
    assert sum(isinstance(part, Ticks) for part in parts) > TICKS // TICKS_OF_A_BUNDLE
    paths = [tmp_path / "at_once.mcap", tmp_path / "one_by_one.mcap"]
    recorders = [
        recorded(setup, path, each)
        for path, each in zip(paths, (parts, map(list, parts)), strict=True)
    ]
    at_once, one_by_one = recorders
    assert at_once._progress == one_by_one._progress
    assert len(at_once._progress) == (2 if clock == "lockstep" else 0)
    for recorder in recorders:
        recorder.close()
    assert at_once.lost == one_by_one.lost
    assert (at_once.lost.total() > 0) == (lacking is not None)
    contents = read_log(paths[0])
    assert contents.complete
    assert len(contents.payloads["tf"]) > 10
    if clock == "lockstep":  # in real time, when the arm was told is by the clock on the wall
        assert paths[0].read_bytes() == paths[1].read_bytes()
    assert messages_in(paths[0]) == messages_in(paths[1])


def messages_in(path: Path) -> list[tuple[str, int, int, int, bytes]]:
    """Messages in the order of the file but those that tell of the arm once."""
    with path.open("rb") as file:
        return [
            (channel.topic, each.sequence, each.log_time, each.publish_time, each.data)
            for _, channel, each in make_reader(file).iter_messages(log_time_order=False)
            if channel.topic not in ("/robot_description", "/tf_static")
        ]


def test_gaps_between_runs_of_numbers_are_counted_as_between_numbers() -> None:
    choice = random.Random(0)
    at_once, one_by_one = GapCounter(), GapCounter()
    for _ in range(500):
        sender, first = choice.randbytes(1) * 16, choice.choice([0, choice.randrange(2000)])
        last = first + choice.randrange(1, 40)
        at_once.note_run("topic", sender, first, last)
        for number in range(first, last + 1):
            one_by_one.note("topic", sender, number)
        assert at_once.missed == one_by_one.missed
