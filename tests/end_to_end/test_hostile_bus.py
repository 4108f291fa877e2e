"""Strangers on the bus: what they send is counted, and makes no verdict better."""

from __future__ import annotations

import json
import os
import random
import signal
import subprocess
import sys
from collections import Counter
from collections.abc import Iterator
from contextlib import closing, contextmanager
from pathlib import Path

import numpy as np
import pytest
import zenoh
from impostor import OWN_ID, Impostor
from running import (
    ENDLESS,
    IN_LOCKSTEP,
    Finished,
    Watcher,
    assert_as_simulated,
    funnel_hil,
    funnel_hil_here,
    settings,
    started,
)

from bus_schema.link.in_process import InProcessBus, InProcessControllerLink, InProcessPlantLink
from bus_schema.link.interface import CommandArrival
from bus_schema.messages.run_event import EventKind, RunEvent
from bus_schema.messages.topics import JOINT_COMMANDS, RUN_EVENTS
from bus_schema.messages.types import JOINT_STATE, TYPESTORE
from bus_schema.runtime.clock import VirtualClock
from bus_schema.zenoh.ros_graph import Attachment
from controller.control_loop import ControlLoop
from deploy.scenario.scenario import load_setup
from plant_emulator.plant_loop import PlantLoop
from plant_emulator.plant_task import PlantOutcome
from tests.waiting import await_true, free_endpoint

JOINTS = ("base_yaw", "shoulder", "elbow")
SHOTS_FROM_S = 0.2
LATER_S = 1.0
"""By then all shots have come: states behind them have come back on the same connection."""
ROUNDS = 5
HUGE_NM = 1e5


def command(torque: list[float], stamp_s: int = 0, names: tuple[str, ...] = JOINTS) -> bytes:
    """A well-formed command. Stamp 0 is the first state, which was answered long ago."""
    types = TYPESTORE.types
    stamp = types["builtin_interfaces/msg/Time"](stamp_s, 0)
    header = types["std_msgs/msg/Header"](stamp, "")
    empty = np.zeros(0)
    message = types[JOINT_STATE](header, list(names), empty, empty, np.array(torque))
    return bytes(TYPESTORE.serialize_cdr(message, JOINT_STATE))


def ammunition() -> list[tuple[str, bytes]]:
    """What is shot, with the reason for which it has to be rejected."""
    noise = random.Random(7)
    valid = command([HUGE_NM] * 3, stamp_s=1_000_000)
    announced = bytearray(valid)
    announced[-32:-28] = (2**31).to_bytes(4, "little")  # the number of efforts that follow
    return [
        ("malformed", b""),
        ("malformed", noise.randbytes(7)),
        ("malformed", noise.randbytes(len(valid))),
        ("malformed", valid[: len(valid) // 2]),
        ("malformed", valid[:-1]),
        ("malformed", bytes(announced)),
        ("malformed", noise.randbytes(60_000)),
        ("oversized", noise.randbytes(500_000)),
        ("oversized", command([HUGE_NM] * 60_000)),
        ("wrong_size", command([HUGE_NM] * 7_500)),  # 60 kB, and well-formed
        ("wrong_size", command([HUGE_NM] * 2)),
        ("wrong_names", command([HUGE_NM] * 2, names=JOINTS[:2])),
        ("wrong_names", command([HUGE_NM] * 4, names=(*JOINTS, "wrist"))),
        ("not_finite", command([np.nan, 0.0, 0.0])),
        ("not_finite", command([0.0, 0.0, -np.inf])),
        ("other_commander", command([HUGE_NM] * 3)),
        ("other_commander", command([HUGE_NM] * 3, stamp_s=-1)),
        ("from_the_future", valid),
    ]


def run_under_fire(out: Path) -> tuple[Finished, Counter[str], float]:
    """A run with a stranger who shoots; what he shot, and how far the run came for sure."""
    sent: Counter[str] = Counter()
    with started(*IN_LOCKSTEP, out=out) as run, Watcher(run.plant_endpoint()) as stranger:
        publisher = stranger.session.publisher(JOINT_COMMANDS.key_expression(0))
        stranger.await_time(SHOTS_FROM_S, run)
        for shot in range(ROUNDS):
            for reason, payload in ammunition():
                publisher.put(payload, Attachment(shot + 1, 0, bytes(16)).encode())
                sent[reason] += 1
        come_s = stranger.last_stamp_ns * 1e-9 + LATER_S
        stranger.await_time(come_s, run)
        run.send(signal.SIGINT)
        return run.end(130), sent, come_s


def test_garbage_on_the_command_key_is_counted_and_changes_nothing(tmp_path: Path) -> None:
    run, sent, come_s = run_under_fire(tmp_path / "run")
    assert run.summary["faults"] == []
    downlink = run.summary["transport"]["downlink"]
    assert downlink["rejected"] == dict(sent)
    assert downlink["delivered"] >= run.summary["ticks"] - 1  # the last may have been on its way
    names = ("joint_states", "joint_commands", "plant_status", "plant_truth")
    assert_as_simulated(run, come_s, tmp_path / "simulation", *names)
    assert max(run.summary["torque"]["peak_nm"]) < HUGE_NM
    assert run.summary["recorder"]["lost"] == 0
    assert len(run.log.payloads["rejected_commands"]) == sum(sent.values())
    replayed = funnel_hil_here("replay", str(run.folder))
    assert "identical" in replayed.output, replayed.output


@contextmanager
def impersonated(out):
    """A run with a stranger that knows all that a forgery needs."""
    with started(*IN_LOCKSTEP, out=out) as run, Impostor(run.plant_endpoint()) as stranger:
        stranger.await_plant(run)
        yield run, stranger


@pytest.mark.parametrize("ids", ["own", "copied"])
def test_false_plant_is_reported_and_leaves_the_verdict_unknown(tmp_path: Path, ids: str) -> None:
    """But for them, a run that is stopped is one that was interrupted."""
    with impersonated(tmp_path / "run") as (run, stranger):
        newest = stranger.spans[-1]
        sender, number = (OWN_ID, 1) if ids == "own" else (newest.sender, newest.last)
        stranger.speak_as_plant(stranger.truth, sender, number)
        ended, _ = run.end_later(LATER_S)
    recording = ended.summary["recording"]
    reason = "second_plant" if ids == "own" else "altered_bundle"
    assert recording["rejected"][reason] >= 1
    assert recording["rejected"]["wrong_role"] >= 1  # the plant's end from a controller
    assert "the plant's name" in recording["damage"][0]
    assert f"{reason}: " in ended.output
    assert ended.summary["verdict"] == "unknown"
    assert not ended.summary["bounds"]["kept"]


@pytest.mark.parametrize(
    "later_ns", [0, 250_000, 20_000_000], ids=["a second answer", "between ticks", "to come"]
)
def test_states_forged_with_the_attachment_of_the_plant_leave_the_verdict_unknown(
    tmp_path: Path, later_ns: int
) -> None:
    """The controller takes them for the plant's, but its answers show them to the plant."""
    with impersonated(tmp_path / "run") as (run, stranger):
        await_true(lambda: stranger.state is not None, "the plant sends states")
        stranger.forge_states(3, later_ns)
        ended, _ = run.end_later(0.5)
    assert ended.summary["faults"] == []
    assert ended.summary["recording"]["rejected"]["forged_state"] >= 1
    assert ended.summary["verdict"] in ("unknown", "lost")
    assert "forged_state: " in ended.output


def test_second_recorder_that_has_everything_ends_no_run(tmp_path: Path) -> None:
    with impersonated(tmp_path / "run") as (run, stranger):
        stranger.speak_as_recorder()
        ended, _ = run.end_later(LATER_S)
    assert ended.summary["faults"] == [], ended.output


@contextmanager
def silent_recorder(endpoint: str) -> Iterator[str]:
    """A client that declares a recorder's token as soon as it can connect, and nothing else."""
    configuration = zenoh.Config()
    for path, value in {
        "connect/endpoints": [endpoint],
        "listen/endpoints": [],
        "connect/exit_on_failure": False,
        "connect/timeout_ms": -1,
        "connect/retry": {"period_init_ms": 5, "period_max_ms": 5, "period_increase_factor": 1},
        "scouting/multicast/enabled": False,
    }.items():
        configuration.insert_json5(path, json.dumps(value))
    with zenoh.open(configuration) as session:
        name = str(session.zid())
        token = f"@ros2_lv/0/{name}/0/0/NN/%/%/funnel_hil_recorder"
        with session.liveliness().declare_token(token):
            yield name


@pytest.mark.parametrize("clock", ["lockstep", "realtime"])
def test_recorder_that_the_run_did_not_start_is_ignored_and_named(
    tmp_path: Path, clock: str
) -> None:
    """In lockstep, loops wait for recorders, and so for one that never acknowledges anything."""
    endpoint = free_endpoint()
    given = settings(clock=clock, duration_s=1.5, link__plant_endpoint=endpoint)
    with silent_recorder(endpoint) as name:
        ended = funnel_hil("run", "paper_arm", *given, out=tmp_path / "run")
    assert ended.summary["faults"] == []
    assert ended.summary["completed"]
    if clock == "lockstep":  # in real time a busy machine may keep the recorder from its work
        assert ended.summary["recorder"]["lost"] == 0
    named = f"a recorder that this run did not start is ignored: session {name}"
    assert ended.output.count(named) == 1


class HauntedPlantLink(InProcessPlantLink):
    """The controller has a name. Behind its replies come commands for the first state again.

    Args:
        bus: where the controller is.
        haunted: the numbers of such replies, all if empty.
        ghost: number and sender of the command behind them.
    """

    def __init__(self, bus: InProcessBus, haunted: set[int], ghost: tuple[int, bytes]) -> None:
        super().__init__(bus)
        self._replies, self._haunted, self._ghost = 0, haunted, ghost

    def take_commands(self) -> list[CommandArrival]:
        own = [each._replace(sender=COMMANDER) for each in super().take_commands()]
        self._replies += bool(own)
        if not own or (self._haunted and self._replies not in self._haunted):
            return own
        return [*own, CommandArrival(command([HUGE_NM] * 3), *self._ghost, 0)]


COMMANDER = b"commander"


def haunted(haunted: set[int], ghost: tuple[int, bytes]) -> tuple[PlantOutcome, InProcessBus]:
    """Outcome of a run of 100 ticks over such a link, and its bus."""
    setup, clock = load_setup("paper_arm", ["duration_s=0.1"]), VirtualClock()
    bus = InProcessBus(clock)
    ControlLoop(setup.control_task(), InProcessControllerLink(bus)).warm_up()
    with closing(setup.arm()) as arm:
        link = HauntedPlantLink(bus, haunted, ghost)
        return PlantLoop(setup.plant_task(lockstep=True), arm, link, clock).run(), bus


def test_stale_command_right_behind_the_reply_does_not_hide_it() -> None:
    outcome, _ = haunted(set(), (1, b""))
    assert outcome.faults == []
    assert outcome.completed


def test_one_forged_number_bars_no_genuine_command_and_is_a_fault() -> None:
    outcome, bus = haunted({3}, (2**62, COMMANDER))
    (fault,) = outcome.faults
    assert "two senders use the commander's id" in fault
    assert not outcome.completed
    assert outcome.ticks == 100  # it goes on
    events = [
        RunEvent.decode(payload)
        for topic, payload in zip(bus.topics, bus.payloads, strict=True)
        if topic is RUN_EVENTS
    ]
    (counts,) = [event.values() for event in events if event.kind == EventKind.COUNTS]
    assert counts["downlink"]["sent"] == 100
    assert {why: n for why, n in counts["downlink"]["rejected"].items() if n} == {"stale": 1}


LONG_S = 4.0
"""In which four times as much is sent as there is room for between a sender and a subscriber."""


@contextmanager
def frozen_subscriber(endpoint: str, mode: str) -> Iterator[subprocess.Popen[bytes]]:
    script = str(Path(__file__).with_name("frozen_subscriber.py"))
    with subprocess.Popen(
        [sys.executable, script, endpoint, mode], stdout=subprocess.PIPE
    ) as process:
        try:
            assert process.stdout is not None
            process.stdout.readline()
            yield process
        finally:
            process.kill()


def is_frozen(process: subprocess.Popen[bytes]) -> bool:
    pid, status = os.waitpid(process.pid, os.WUNTRACED | os.WNOHANG)
    assert not pid or os.WIFSTOPPED(status), "it ended"
    return bool(pid)


@pytest.mark.parametrize(("clock", "mode"), [("lockstep", "client"), ("realtime", "peer")])
def test_frozen_subscriber_changes_nothing(tmp_path: Path, clock: str, mode: str) -> None:
    endpoint = free_endpoint()
    patient = settings(
        clock=clock,
        link__plant_endpoint=endpoint,
        link__controller_endpoint=free_endpoint(),
        plant__command_timeout_ms=30_000.0,
    )
    with (
        frozen_subscriber(endpoint, mode) as stranger,
        started("run", "paper_arm", *ENDLESS, *patient, out=tmp_path / "run") as run,
    ):
        await_true(lambda: is_frozen(stranger), "it has received something")
        ended, come_s = run.end_later(LONG_S)
        assert stranger.returncode is None
    assert ended.summary["faults"] == [], ended.output
    lost = ended.summary["recorder"]["lost_by_topic"].get("plant_truth", 0)
    skipped = ended.summary["recording"]["ticks_skipped"]
    assert len(ended.log.payloads["plant_truth"]) + lost + skipped >= round(1000 * come_s)
    if clock == "lockstep":  # in real time a busy machine may keep the recorder from its work
        assert ended.summary["recorder"]["lost"] == 0
        names = ("joint_states", "joint_commands", "plant_status", "plant_truth")
        assert_as_simulated(ended, come_s, tmp_path / "simulation", *names)
