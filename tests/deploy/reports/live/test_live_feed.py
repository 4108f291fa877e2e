"""A recorder feeds live views without waiting for them."""

import socket
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from bus_schema.messages import topics
from bus_schema.messages.record import Record
from deploy.run.network.live_feed import FeedReceiver, LiveFeed, clear_left_behind
from deploy.run.network.snapshot import Message, Sampler, Snapshot

NAMES = ("base_yaw", "shoulder", "elbow")
STATES, TRUTH, EVENTS = topics.JOINT_STATES, topics.PLANT_TRUTH, topics.RUN_EVENTS
ENDPOINT = "tcp/127.0.0.1:7451"


def truth(stamp_ns, *, met, skipped=False):
    record = Record(topics.layout(TRUTH, NAMES))
    record.stamp_ns = stamp_ns
    record.scalars.deadline_met = met
    record.scalars.timing_lateness_ns = -1 if skipped else 0
    return Message(TRUTH, stamp_ns, record.payload())


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.setattr("deploy.run.network.live_feed._folder", lambda: tmp_path / "s")
    return tmp_path / "s"


@pytest.fixture
def feed(folder, tmp_path):
    made = LiveFeed(ENDPOINT, tmp_path / "scenario.yaml", NAMES)
    yield made
    made.close()


@pytest.fixture
def receiver(folder):
    made = FeedReceiver(ENDPOINT)
    yield made
    made.close()


def meet(feed, receiver):
    """A viewer asks, a recorder hears it, and the viewer hears of the scenario."""
    receiver.receive(0.01)
    feed.send()
    assert receiver.receive(5.0) is None


def test_the_newest_of_each_topic_is_shown_and_every_event_and_every_deadline_counts():
    sampler = Sampler(NAMES)
    for tick in range(100):
        sampler.take(truth(tick, met=tick % 10 != 3, skipped=tick in (3, 4)))
        sampler.take(Message(STATES, tick, b"state %d" % tick))
    for number in range(3):
        sampler.take(Message(EVENTS, 99, b"event %d" % number))
    ticks, missed, messages = sampler.snapshot()
    assert (ticks, missed) == (99, 11)  # the first is reported before any has ended
    assert [(m.topic.name, m.stamp_ns) for m in messages[:2]] == [
        ("plant_truth", 99), ("joint_states", 99),
    ]  # fmt: skip
    assert [m.payload for m in messages[2:]] == [b"event 0", b"event 1", b"event 2"]
    assert sampler.snapshot() is None


def test_another_recorder_that_clears_up_meanwhile_leaves_a_socket_that_is_about_to_listen(
    folder, tmp_path, monkeypatch
):
    listen = socket.socket.listen

    def clear_up_and_listen(made):
        clear_left_behind()
        listen(made)

    monkeypatch.setattr(socket.socket, "listen", clear_up_and_listen)
    feed, receiver = LiveFeed(ENDPOINT, tmp_path / "scenario.yaml", NAMES), FeedReceiver(ENDPOINT)
    meet(feed, receiver)
    assert receiver.scenario == tmp_path / "scenario.yaml"
    receiver.close()
    feed.close()
    assert not folder.exists()


def test_viewer_receives_scenario_and_messages(feed, receiver, tmp_path):
    meet(feed, receiver)
    assert receiver.scenario == tmp_path / "scenario.yaml"
    state = Message(STATES, 7, np.random.default_rng(1).bytes(300))
    feed.take(state)
    for tick in (8, 9):
        feed.take(truth(tick, met=tick == 8))
    feed.send()
    assert receiver.receive(5.0) == Snapshot(1, 1, (state, truth(9, met=False)))
    assert receiver.receive(0.1) is None


def test_several_viewers_see_the_same(feed, receiver, folder):
    other = FeedReceiver(ENDPOINT)
    for each in (receiver, other):
        meet(feed, each)
    feed.take(truth(8, met=True))
    feed.send()
    assert receiver.receive(5.0) == other.receive(5.0)
    other.close()


def test_viewer_that_reads_nothing_does_not_block_the_sender(feed, receiver):
    meet(feed, receiver)
    for tick in range(2000):  # far more than its socket holds; a sender that waits hangs here
        feed.take(Message(STATES, tick, bytes(1000)))
        feed.send()
    assert 0 < feed.dropped < 2000
    receiver.close()
    feed.take(Message(STATES, 0, b""))
    feed.send()
    assert not feed.is_watched


def test_a_viewer_knows_when_the_recorder_has_left_and_finds_another_one(feed, receiver, tmp_path):
    receiver.receive(0.01)
    assert (receiver.scenario, receiver.is_over) == (None, False)
    meet(feed, receiver)
    feed.close()
    receiver.receive(0.01)
    assert receiver.is_over
    again = LiveFeed(ENDPOINT, tmp_path / "again.yaml", NAMES)
    meet(again, receiver)
    assert (receiver.scenario, receiver.is_over) == (tmp_path / "again.yaml", False)
    again.close()


def test_a_run_elsewhere_is_not_shown(feed, folder):
    other = FeedReceiver("tcp/127.0.0.1:7499")
    other.receive(0.01)
    feed.send()
    assert other.receive(0.1) is None
    assert other.scenario is None
    other.close()


def test_flood_of_connections_and_packets_changes_nothing(feed, receiver):
    strangers = [socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET) for _ in range(60)]
    for stranger in strangers:
        stranger.setblocking(False)
        try:
            stranger.connect(str(feed._place))
            for packet in (b"funnel-hil", b"\0" * 3000):
                stranger.send(packet)
        except (BlockingIOError, ConnectionError):
            feed.send()
    for stranger in strangers:
        stranger.close()
    feed.take(truth(1, met=True))
    feed.send()  # which forgets those that have left
    meet(feed, receiver)
    assert receiver.scenario is not None


def test_what_killed_processes_left_is_cleared_away(folder, tmp_path):
    folder.mkdir(mode=0o700)
    left = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    left.bind(str(folder / "recorder-1-1"))
    left.close()
    feed = LiveFeed(ENDPOINT, tmp_path / "scenario.yaml", NAMES)
    assert len(list(folder.iterdir())) == 1
    feed.close()
    assert not folder.exists()


@pytest.mark.parametrize("step", ["lstat", "iterdir"])
def test_a_folder_that_others_remove_meanwhile_is_made_again(folder, tmp_path, monkeypatch, step):
    removed, proper = [], getattr(Path, step)

    def after_removal(self):
        if self == folder and not removed:
            removed.append(self)
            self.rmdir()
        return proper(self)

    monkeypatch.setattr(Path, step, after_removal)
    feed = LiveFeed(ENDPOINT, tmp_path / "scenario.yaml", NAMES)
    assert removed == [folder]
    assert feed._place.is_socket()
    feed.close()


def test_folders_that_others_keep_beside_the_sockets_stay(folder, receiver, tmp_path):
    kernels = folder / "numba"
    kernels.mkdir(parents=True)
    folder.chmod(0o700)
    feed = LiveFeed(ENDPOINT, tmp_path / "scenario.yaml", NAMES)
    meet(feed, receiver)
    assert receiver.scenario == tmp_path / "scenario.yaml"
    feed.close()
    clear_left_behind()
    assert kernels.is_dir()


def test_a_folder_that_others_can_enter_is_not_used(folder):
    folder.mkdir()
    folder.chmod(0o755)
    with pytest.raises(PermissionError, match="only this user"):
        FeedReceiver(ENDPOINT)


@given(st.binary(max_size=200))
def test_any_bytes_are_a_snapshot_or_refused(datagram):
    try:
        snapshot = Snapshot.decode(datagram)
    except ValueError:
        return
    assert snapshot.encode() == datagram
