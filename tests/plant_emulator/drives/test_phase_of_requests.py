"""The plant's ticks in real time stay ahead of requests, also where its host is slow.

Time is the test's: frames come on the master's grid, and each one that is read costs time.
"""

from __future__ import annotations

from collections.abc import Sequence

import pytest

from bus_schema.can.frame import CanFrame
from bus_schema.link.in_process import InProcessBus, InProcessNode
from bus_schema.messages.layout import Record
from bus_schema.messages.topics import JOINT_STATES, PLANT_STATUS, Role, layout
from bus_schema.runtime.clock import VirtualClock
from deploy.link_kinds import can as can_kind
from deploy.link_kinds.can import CanKind
from deploy.scenario.scenario import load_setup

MS = 1_000_000
PERIOD_NS = 2 * MS
LEAD_NS = 300_000
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


class MastersBus:
    """Requests of all seven drives every 2 ms, each of which takes its reader some time."""

    def __init__(self, clock: MastersTime, read_ns: int) -> None:
        self._clock, self._read_ns = clock, read_ns
        self._next = 0

    def receive(self, timeout_s: float) -> CanFrame | None:
        tick, joint = divmod(self._next, len(REQUESTS))
        comes_ns, until_ns = tick * PERIOD_NS, self._clock.master_ns + round(timeout_s * 1e9)
        self._clock.master_ns = max(self._clock.master_ns, min(comes_ns, until_ns))
        if comes_ns > until_ns:
            return None
        self._next += 1
        self._clock.master_ns += self._read_ns
        return REQUESTS[joint]

    def send_all(self, frames: Sequence[CanFrame]) -> None:
        pass

    def dropped(self) -> int | None:
        return None

    def close(self) -> None:
        pass


@pytest.mark.parametrize(
    ("read_ns", "busy_ns"), [(45_000, 0), (70_000, 150_000), (45_000, 450_000)]
)
def test_ticks_stay_ahead_of_requests_on_a_slow_host(
    monkeypatch: pytest.MonkeyPatch, read_ns: int, busy_ns: int
) -> None:
    """Seven requests take 0.3 ms to read, and more: that is no sign of a late master.

    Else the clock would be set back until requests come before the tick, and are answered with the
    state before it.
    """
    setup = load_setup("openarm", ["duration_s=20", "clock=realtime", "rate_hz=500"])
    clock, arm = MastersTime(), setup.arm()
    bus = MastersBus(clock, read_ns)
    telemetry = InProcessNode(InProcessBus(VirtualClock()), Role.PLANT)
    monkeypatch.setattr(can_kind, "open_can_bus", lambda _: bus)
    monkeypatch.setattr(can_kind, "open_telemetry", lambda *_, **__: telemetry)
    link = CanKind().open_plant(setup.link_run(lockstep=False), arm, clock)
    link.await_controller(60.0)
    names = setup.robot.joint_names
    state = Record(layout(JOINT_STATES, names)).payload()
    for tick in range(1, 2000):
        link.wait_until(clock, tick * PERIOD_NS)
        link.send_state(state, layout(PLANT_STATUS, names).template)
        clock.master_ns += busy_ns
    assert clock.ahead_ns == pytest.approx(LEAD_NS, abs=read_ns + 10_000)
    link.close()
    arm.close()
