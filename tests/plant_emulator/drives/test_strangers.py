"""Reports of the plant about other nodes on its CAN bus, and about a late host."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
import pytest
from link_bench import LinkBench, QuietBus

from bus_schema.can.cansimple.codec import CanSimpleCodec
from bus_schema.can.cia402.codec import Cia402Codec
from bus_schema.can.codec import CanCodec
from bus_schema.can.frame import CanFrame
from bus_schema.errors import BusError
from bus_schema.messages.topics import Role
from bus_schema.runtime.clock import HostLateness, VirtualClock
from plant_emulator.drives.strangers import Strangers
from plant_emulator.plant_loop import PlantLoop

MS = 1_000_000
HANG_S = 60.0
LEAD_NS = 300_000
CODECS: dict[str, tuple[CanCodec, CanFrame]] = {
    "cia402": (Cia402Codec((1, 2), 1 << 20, np.ones(2)), CanFrame(0x182, bytes(8))),
    "cansimple": (CanSimpleCodec((1, 2)), CanFrame(2 << 5 | 0x09, bytes(8))),
}


@pytest.mark.parametrize("protocol", CODECS)
def test_frames_that_only_a_drive_sends_name_another_drive(protocol: str) -> None:
    codec, state = CODECS[protocol]
    strangers = Strangers(codec, (1, 2), 2 * MS)
    strangers.note(state, None, 0)
    assert strangers.in_words() == "another drive on this bus has address 2 and sent 1 states"


@pytest.mark.parametrize("protocol", CODECS)
def test_more_commands_than_cycles_name_another_master(protocol: str) -> None:
    codec, _ = CODECS[protocol]
    alone, joined = (Strangers(codec, (1, 2), 2 * MS) for _ in range(2))
    for tick in range(50):
        for joint, frame in enumerate(codec.command_frames(np.zeros(2))):
            alone.note(frame, joint, tick * 2 * MS)
            joined.note(frame, joint, tick * 2 * MS)
            joined.note(frame, joint, tick * 2 * MS)
    assert alone.in_words() == ""
    assert "another master is on this bus: drive 1 was sent 100 commands in 50 cycles" in (
        joined.in_words()
    )


def test_lateness_is_named_while_it_is_recent_and_worth_it() -> None:
    lateness = HostLateness()
    lateness.note(19 * MS, 100 * MS)
    assert lateness.in_words(100 * MS) == ""
    lateness.note(60 * MS, 200 * MS)
    lateness.note(1 * MS, 210 * MS)
    assert lateness.in_words(300 * MS) == "this host was late by 60 ms, 0.20 s into the run"
    assert lateness.in_words(2000 * MS) == ""
    lateness.note(30 * MS, 2000 * MS)
    assert "30 ms" in lateness.in_words(2000 * MS)


class HandClock(VirtualClock):
    """Time by hand, for a link that takes it for real."""

    def set_ms(self, now_ms: int) -> None:
        self.wait_until(now_ms * MS)

    def put_forward(self, by_ns: int) -> None:
        self.wait_until(self.now_ns() + by_ns)


class HeldUpBus(QuietBus):
    """Gives frames and a SYNC; then time passes by who waits for frames, and holds him up once.

    Attributes:
        frames: what is to be read.
        hold_up_ms: by how long the next to wait is held up.
        sent: what was sent.
        error: what ends it.
    """

    def __init__(self, clock: HandClock, before_sync: Sequence[CanFrame]) -> None:
        super().__init__(clock)
        self.frames = [*before_sync, CanFrame(0x080)]
        self.hold_up_ms = 0
        self.sent: list[CanFrame] = []
        self.error: Exception | None = None

    def send(self, frame: CanFrame) -> None:
        self.sent.append(frame)

    def send_all(self, frames: Sequence[CanFrame]) -> None:
        self.sent.extend(frames)

    def receive(self, timeout_s: float) -> CanFrame | None:
        if self.error is not None:
            raise self.error
        waited_ns = self.hold_up_ms * MS
        self.hold_up_ms = 0
        if not (self.frames or waited_ns):
            waited_ns = round(timeout_s * 1e9)
        self._clock.wait_until(self._clock.now_ns() + waited_ns)
        return self.frames.pop(0) if self.frames else None


class Held(LinkBench):
    """A link in real time whose loop is held up."""

    def __init__(self, monkeypatch, before_sync=(), *overrides):
        clock = HandClock()
        bus = HeldUpBus(clock, before_sync)
        super().__init__(monkeypatch, bus, clock, "paper_arm_can", *overrides)

    def sent(self, identifier):
        return sum(frame.identifier == identifier for frame in self.bus.sent)

    @property
    def states(self):
        return self.sent(0x181)

    @property
    def heartbeats(self):
        return self.sent(0x701)


@pytest.fixture
def held(monkeypatch: pytest.MonkeyPatch) -> Iterator[Held]:
    made = Held(monkeypatch)
    yield made
    made.close()


def test_what_the_master_sent_before_it_left_is_read(held: Held) -> None:
    """Else it would depend on the machine which frames the drives' log ends with."""
    held.measure()
    held.bus.frames += [CanFrame(0x080), CanFrame(0x080)]
    held.others.leave(Role.CONTROLLER)
    held.link.await_recorded()
    assert held.bus.frames == []


def test_drives_miss_nothing_that_a_held_up_host_has_not_read(held: Held) -> None:
    """They send a heartbeat every 100 ms of their time, which stands still meanwhile."""
    held.measure()
    before = held.heartbeats
    held.clock.set_ms(500)
    held.measure()
    assert held.heartbeats == before
    held.reach(502 * MS)
    held.measure()
    assert held.heartbeats > before


def test_what_came_while_the_loop_was_held_up_is_read_before_it_goes_on(held: Held) -> None:
    held.measure()
    held.bus.frames += [CanFrame(0x202, bytes(4))] * 50
    held.bus.hold_up_ms = 100
    assert held.reach(2 * MS) == 98 * MS
    assert held.bus.frames == []


def test_drives_answer_with_nothing_before_their_joints_were_measured(monkeypatch):
    """The SYNC that began the run waits: at 0 rad they are not."""
    held = Held(monkeypatch, [CanFrame(0x000, bytes([1, 0]))])  # all nodes operational
    held.clock.set_ms(20)
    held.reach(2 * MS)
    assert held.states == 0
    held.measure()
    held.reach(4 * MS)
    assert held.states == 1
    held.close()


def test_run_whose_first_sampling_is_read_late_has_the_time_of_the_master(monkeypatch):
    sampling = [CanFrame(node << 5 | 0x09, is_remote=True) for node in (1, 2, 3)]
    # The process was held up for 7 ms, in which the master went on.
    held = Held(monkeypatch, sampling * 4, "link.can.protocol=cansimple")
    began_ns = held.clock.now_ns()
    held.clock.put_forward(LEAD_NS)
    held.link.await_command(0.0)
    held.clock.put_forward(1 * MS)
    held.bus.frames = sampling  # the fifth is read as it comes, 8 ms into the run
    held.link.await_command(0.0)
    assert held.clock.now_ns() - began_ns == 8 * MS + LEAD_NS
    held.close()


def test_flood_keeps_no_instant_from_coming(held: Held) -> None:
    """Each frame takes its reader half a millisecond."""
    held.measure()
    took_ms = 0.5

    def receive(_: float) -> CanFrame:
        held.clock.wait_until(held.clock.now_ns() + round(took_ms * MS))
        return CanFrame(0x7FF)

    held.bus.receive = receive  # type: ignore[method-assign, assignment]
    assert held.reach(2 * MS) < MS
    took_ms = 10.0
    held.reach(4 * MS)
    assert held.clock.now_ns() < 30 * MS


@pytest.mark.parametrize("error", [BusError("Network is down"), RuntimeError("not to be expected")])
def test_run_without_a_bus_is_ended_by_its_cause(held: Held, error: Exception) -> None:
    held.bus.error = error
    task = held.setup.plant_task(lockstep=False)
    outcome = PlantLoop(task, held.arm, held.link, held.clock).run()
    (fault,) = outcome.faults
    assert str(error) in fault
    assert not outcome.completed


def test_fault_after_a_delay_names_the_host_and_other_nodes(held: Held) -> None:
    held.bus.frames += [CanFrame(0x183, bytes(8))]
    held.measure()
    held.reach(2 * MS)
    held.bus.hold_up_ms = 498
    held.reach(4 * MS)
    held.measure()
    assert held.link.fault() is None  # nothing has gone wrong by that alone
    held.bus.error = BusError("the bus is gone")
    held.reach(502 * MS)
    fault = str(held.link.fault())
    assert "the bus is gone" in fault
    assert "another drive on this bus has address 3 and sent 1 states" in fault
    assert "this host was late by 496 ms, 0.50 s into the run" in fault
