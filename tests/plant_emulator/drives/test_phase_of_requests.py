"""The plant's ticks in real time stay ahead of requests, also where its host is slow.

Time is the test's: frames come on the master's grid, and each one that is read costs time.
"""

from __future__ import annotations

import random
from collections.abc import Sequence

import pytest
from link_bench import LinkBench, QuietBus

from bus_schema.can.frame import CanFrame
from bus_schema.runtime.clock import VirtualClock

MS = 1_000_000
PERIOD_NS = 2 * MS
LEAD_NS = 300_000
TICKS = 2000
REQUESTS = [
    CanFrame(0x7FF, bytes([node, 0, 0xCC, 0, 0, 0, 0, 0]), is_fd=True) for node in range(1, 8)
]


class MastersTime(VirtualClock):
    """The plant's clock over a time that the master shares.

    Attributes:
        master_ns: the master's time.
        ahead_ns: how far the plant's clock is ahead of it.
    """

    def __init__(self) -> None:
        self.master_ns = self.ahead_ns = 0

    def start(self) -> None:
        """Time began with the anchor."""

    def anchor(self, ago_ns: int) -> None:
        self.ahead_ns = (
            LEAD_NS - self.master_ns
        )  # the wall time since the first one does not count here

    def now_ns(self) -> int:
        return self.master_ns + self.ahead_ns

    def put_forward(self, by_ns: int) -> None:
        self.ahead_ns += by_ns

    def wait_until(self, instant_ns: int) -> int:
        self.master_ns = max(self.master_ns, instant_ns - self.ahead_ns)
        return 0


class MastersBus(QuietBus):
    """Requests of all seven drives every 2 ms, each of which takes its reader some time.

    Args:
        clock: time of master and plant.
        read_ns: what it takes to read one.
        wakes_late_ns: how late a reader wakes up who waits in vain.
        jitter_ns: by how much the master's cycle may begin late.

    Attributes:
        answers: how many were sent.
    """

    def __init__(self, clock, read_ns, wakes_late_ns, jitter_ns):
        super().__init__(clock)
        self._read_ns, self._wakes_late_ns = read_ns, wakes_late_ns
        self._next = self.answers = self._stray_ns = 0
        self._frames = REQUESTS
        random_ns = random.Random(1)
        self._begin_ns = [
            tick * PERIOD_NS + random_ns.randint(0, jitter_ns) for tick in range(TICKS + 1)
        ]

    def join(self, stray_ns: int) -> None:
        """Another master joins, which asks the first drive so long after each tick."""
        self._next = -(-self._next // len(REQUESTS)) * (len(REQUESTS) + 1)
        self._frames, self._stray_ns = [*REQUESTS, REQUESTS[0]], stray_ns

    def receive(self, timeout_s: float) -> CanFrame | None:
        tick, place = divmod(self._next, len(self._frames))
        comes_ns, until_ns = self._begin_ns[tick], self._clock.master_ns + round(timeout_s * 1e9)
        comes_ns += self._stray_ns if place == len(REQUESTS) else 0
        if comes_ns > until_ns and timeout_s > 0.0:
            until_ns += self._wakes_late_ns
        self._clock.master_ns = max(self._clock.master_ns, min(comes_ns, until_ns))
        if comes_ns > until_ns:
            return None
        self._next += 1
        self._clock.master_ns += self._read_ns
        return self._frames[place]

    def send_all(self, frames: Sequence[CanFrame]) -> None:
        self.answers += len(frames)


def motors_of(monkeypatch, read_ns, wakes_late_ns=0, jitter_ns=0):
    """The plant's link to the motors of `openarm`, whose time is a `MastersTime`."""
    clock = MastersTime()
    bus = MastersBus(clock, read_ns, wakes_late_ns, jitter_ns)
    return LinkBench(monkeypatch, bus, clock, "openarm", "rate_hz=500")


@pytest.mark.parametrize(
    ("read_ns", "busy_ns", "jitter_ns"),
    [(45_000, 0, 0), (70_000, 150_000, 0), (45_000, 450_000, 0), (20_000, 350_000, 200_000)],
)
def test_ticks_stay_ahead_of_requests_on_a_slow_host(monkeypatch, read_ns, busy_ns, jitter_ns):
    """Seven requests take 0.3 ms to read, and more: that is no sign of a late master.

    Else the clock would be set back until requests come before the tick, and are answered with the
    state before it. Requests that come after the plant's work are no sign of one either.
    """
    motors = motors_of(monkeypatch, read_ns, jitter_ns=jitter_ns)
    for tick in range(1, TICKS):
        motors.reach(tick * PERIOD_NS)
        motors.measure()
        motors.clock.master_ns += busy_ns
    assert motors.clock.ahead_ns == pytest.approx(LEAD_NS, abs=read_ns + 10_000 + jitter_ns // 4)
    motors.close()


def test_requests_after_a_tick_get_its_state_also_from_a_host_that_wakes_late(monkeypatch):
    """A request that was sent after the tick is there when the host wakes up for it."""
    motors = motors_of(monkeypatch, read_ns=5_000, wakes_late_ns=LEAD_NS + 100_000)
    answers_before_tick = []
    for tick in range(1, 50):
        motors.reach(tick * PERIOD_NS)
        answers_before_tick.append(motors.bus.answers)
        motors.measure()
    # At the first one, no joint was measured yet; before each other, one set of requests per tick.
    assert answers_before_tick == [0, *(len(REQUESTS) * tick for tick in range(2, 50))]
    motors.close()


def test_a_second_master_that_asks_one_drive_turns_the_clock_little(monkeypatch):
    """Its request comes after the sampling of each tick, and begins no other one."""
    motors = motors_of(monkeypatch, read_ns=5_000)
    for tick in range(1, 600):
        if tick == 50:
            motors.bus.join(stray_ns=400_000)
        motors.reach(tick * PERIOD_NS)
        motors.measure()
    assert motors.clock.ahead_ns == pytest.approx(LEAD_NS, abs=15_000)
    motors.close()


def test_requests_that_are_read_in_a_row_after_a_hold_up_keep_their_own_times(monkeypatch):
    """Four cycles have waited for the plant until 7.5 ms, and the fifth comes at 8 ms.

    Timed by the first, the fifth would seem to come 0.5 ms early, and put the clock forward.
    """
    motors = motors_of(monkeypatch, read_ns=10_000)
    motors.measure()
    motors.clock.master_ns = 7_500_000
    for tick in range(4, 30):
        motors.reach(tick * PERIOD_NS)
        motors.measure()
    assert motors.clock.ahead_ns == pytest.approx(LEAD_NS, abs=20_000)
    motors.close()
