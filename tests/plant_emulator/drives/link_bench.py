"""The plant's link over a bus of the test, in real time by a clock of the test."""

from __future__ import annotations

from bus_schema.link.in_process import InProcessBus, InProcessNode
from bus_schema.messages.record import Record
from bus_schema.messages.topics import JOINT_STATES, PLANT_STATUS, Role, layout
from bus_schema.runtime.clock import VirtualClock
from deploy.scenario.link_kinds import can as can_kind
from deploy.scenario.link_kinds.can import CanKind
from deploy.scenario.scenario import load_setup


class QuietBus:
    """A bus that drops nothing; others add what is received, and what is sent.

    Args:
        clock: time that goes on while the plant waits for frames.
    """

    def __init__(self, clock):
        self._clock = clock

    def dropped(self):
        return None

    def close(self):
        pass


class LinkBench:
    """A link of the plant.

    Args:
        monkeypatch: replaces the buses that the link opens.
        bus: the CAN bus.
        clock: the plant's time.
        scenario: scenario and overrides.

    Attributes:
        others: the bus of all other messages.
    """

    def __init__(self, monkeypatch, bus, clock, *scenario):
        name, *overrides = scenario
        self.setup = load_setup(name, ["duration_s=20", "clock=realtime", *overrides])
        self.bus, self.clock, self.arm = bus, clock, self.setup.arm()
        self.others = InProcessBus(VirtualClock())
        telemetry = InProcessNode(self.others, Role.PLANT)
        monkeypatch.setattr(can_kind, "open_can_bus", lambda _: bus)
        monkeypatch.setattr(can_kind, "open_telemetry", lambda *_, **__: telemetry)
        self.link = CanKind().open_plant(self.setup.link_run(lockstep=False), self.arm, clock)
        self.link.await_controller(60.0)

    def measure(self):
        names = self.setup.robot.joint_names
        state = Record(layout(JOINT_STATES, names)).payload()
        self.link.send_state(state, layout(PLANT_STATUS, names).template)

    def reach(self, instant_ns):
        """Wait until an instant; return how late that was."""
        return self.link.wait_until(self.clock, instant_ns)

    def close(self):
        self.link.close()
        self.arm.close()
