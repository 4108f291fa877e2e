"""The plant's side over CAN in real time: whatever ends the serving of frames is told."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import pytest

from bus_schema.can.frame import CanFrame
from bus_schema.errors import BusError
from bus_schema.link.in_process import InProcessBus, InProcessNode
from bus_schema.messages.layout import Record
from bus_schema.messages.topics import JOINT_STATES, PLANT_STATUS, Role, layout
from bus_schema.runtime.clock import Clock, MonotonicClock, VirtualClock
from deploy.link_kinds import can as can_kind
from deploy.link_kinds.can import CanKind
from deploy.scenario.scenario import load_setup
from deploy.scenario.setup import Setup
from plant_emulator.arm_plant import ArmPlant
from plant_emulator.drives.can_plant_link import CanPlantLink
from plant_emulator.plant_loop import PlantLoop

HANG_S = 60.0
SYNC = CanFrame(0x080)


class FailingBus:
    """Gives one SYNC, so that the run begins, and then fails whenever it is asked for more."""

    def __init__(self, error: Exception) -> None:
        self._error = error
        self._frames = [SYNC]

    def send(self, frame: CanFrame) -> None:
        pass

    def send_all(self, frames: Sequence[CanFrame]) -> None:
        pass

    def receive(self, timeout_s: float) -> CanFrame:
        if not self._frames:
            raise self._error
        return self._frames.pop()

    def dropped(self) -> int | None:
        return None

    def close(self) -> None:
        pass


@pytest.fixture
def setup() -> Setup:
    return load_setup("paper_arm_can", ["duration_s=20", "clock=realtime"])


@pytest.fixture
def arm(setup: Setup) -> Iterator[ArmPlant]:
    arm = setup.arm()
    yield arm
    arm.close()


def open_link(
    setup: Setup, arm: ArmPlant, error: Exception, monkeypatch: pytest.MonkeyPatch
) -> tuple[CanPlantLink, Clock]:
    clock = MonotonicClock()
    telemetry = InProcessNode(InProcessBus(VirtualClock()), Role.PLANT)
    monkeypatch.setattr(can_kind, "open_can_bus", lambda _: FailingBus(error))
    monkeypatch.setattr(can_kind, "open_telemetry", lambda *_, **__: telemetry)
    return CanKind().open_plant(setup.link_run(lockstep=False), arm, clock), clock


@pytest.mark.parametrize(
    "error", [BusError("CAN channel vcan0: Network is down"), RuntimeError("not to be expected")]
)
def test_what_ends_the_serving_of_frames_is_a_fault(
    setup: Setup, arm: ArmPlant, error: Exception, monkeypatch: pytest.MonkeyPatch
) -> None:
    link, clock = open_link(setup, arm, error, monkeypatch)
    clock.wait_until(50_000_000)
    link.await_controller(HANG_S)
    assert clock.now_ns() >= 50_000_000  # the drives' own time goes on: the run has not begun yet
    assert link.fault() is None
    state = Record(layout(JOINT_STATES, setup.robot.joint_names))
    link.send_state(state.payload(), layout(PLANT_STATUS, setup.robot.joint_names).template)
    instant_ns = clock.now_ns() + 10_000_000
    link.wait_until(clock, instant_ns)
    assert clock.now_ns() >= instant_ns  # the arm is still to be stopped
    assert str(error) in str(link.fault())
    link.await_recorded()  # nobody is left to wait for
    link.close()


def test_run_without_a_bus_is_ended_by_its_cause(
    setup: Setup, arm: ArmPlant, monkeypatch: pytest.MonkeyPatch
) -> None:
    link, clock = open_link(setup, arm, BusError("Network is down"), monkeypatch)
    link.await_controller(HANG_S)
    outcome = PlantLoop(setup.plant_task(lockstep=False), arm, link, clock).run()
    link.close()
    assert len(outcome.faults) == 1
    assert "Network is down" in outcome.faults[0]
    assert not outcome.completed
