"""In real time: an answer that came too late for its tick is never taken for that of another."""

from __future__ import annotations

import math
import struct
from collections import Counter
from collections.abc import Sequence
from pathlib import Path

from bus_schema.can.cansimple.codec import CanSimpleCodec, CommandId
from bus_schema.can.cansimple.protocol import CanSimpleMaster
from bus_schema.can.frame import CanFrame
from bus_schema.can.link import CanControllerLink, CanRun
from bus_schema.link.can_configuration import CanConfiguration
from bus_schema.link.configuration import LinkConfiguration
from bus_schema.link.in_process import InProcessBus, InProcessNode
from bus_schema.messages.record import Record
from bus_schema.messages.topics import JOINT_COMMANDS, JOINT_STATES, Role, layout
from bus_schema.robot_description import load_robot
from bus_schema.runtime.clock import TickGrid, VirtualClock
from controller.control_loop import ControlLoop
from deploy.scenario.referenced_files import find_urdf
from deploy.scenario.scenario import load_setup

NODES = (1, 2, 3)
GRID = TickGrid(500.0, 1)
TICKS = 6
ROBOT = load_robot(find_urdf("paper_arm", Path()))


class LateAxes:
    """A bus with axes that are held up for the first few requests, then answer them all.

    The position they answer with is the number of the request, in rad.

    Args:
        held_up: how many requests they only answer with the next one after them.
    """

    def __init__(self, held_up: int) -> None:
        self._held_up = held_up
        self._asked: Counter[int] = Counter()
        self._state = 1
        self._owed: list[CanFrame] = []
        self._sent: list[CanFrame] = []

    def send_all(self, frames: Sequence[CanFrame]) -> None:
        for frame in frames:
            command = frame.identifier & 0x1F
            if frame.is_remote and command == CommandId.GET_ENCODER_ESTIMATES:
                turns = self._asked[frame.identifier] / (2.0 * math.pi)
                self._owed.append(CanFrame(frame.identifier, struct.pack("<ff", turns, 0.0)))
                self._asked[frame.identifier] += 1
                if self._asked[frame.identifier] > self._held_up:
                    self._sent += self._owed
                    self._owed = []
            elif frame.is_remote and command == CommandId.HEARTBEAT:
                beat = struct.pack("<IBB", 0, self._state, 0) + bytes(2)
                self._sent.append(CanFrame(frame.identifier, beat))
            elif command == 0x07:
                (self._state,) = struct.unpack("<I", frame.data)

    def receive(self, timeout_s: float) -> CanFrame | None:
        return self._sent.pop(0) if self._sent else None

    def close(self) -> None:
        pass


def open_link(bus: LateAxes) -> CanControllerLink:
    can = CanConfiguration(node_ids=list(NODES))
    link = LinkConfiguration(kind="can", can=can)
    run = CanRun(ROBOT.joint_names, link, GRID, TICKS, lockstep=False)
    master = CanSimpleMaster(bus, can, NODES, CanSimpleCodec(NODES))  # type: ignore[arg-type]
    clock = VirtualClock()
    telemetry = InProcessNode(InProcessBus(clock), Role.CONTROLLER)
    return CanControllerLink(run, master, bus, clock, telemetry)  # type: ignore[arg-type]


def positions_by_tick(bus: LateAxes) -> dict[int, set[int]]:
    """What the controller's link hands out as the joints' positions at each tick."""
    link = open_link(bus)
    state = Record(layout(JOINT_STATES, ROBOT.joint_names))
    command = layout(JOINT_COMMANDS, ROBOT.joint_names).template
    found: dict[int, set[int]] = {}

    def take(payload: bytes, _status: bytes | None) -> None:
        layout(JOINT_STATES, ROBOT.joint_names).decode(payload, state)
        positions = state.fields["position"].round().astype(int).tolist()
        found[state.stamp_ns // GRID.period_ns] = set(positions)
        link.publish(JOINT_COMMANDS, command)

    link.serve(take)
    link.spin()
    return found


def test_answers_in_time_are_those_of_their_ticks() -> None:
    assert positions_by_tick(LateAxes(0)) == {tick: {tick} for tick in range(TICKS)}


def test_states_that_were_late_once_do_not_stay_late() -> None:
    found = positions_by_tick(LateAxes(2))
    assert set(found) == {2, 3, 4, 5}
    assert [found[tick] for tick in (3, 4, 5)] == [{3}, {4}, {5}]


def test_reference_begins_with_the_run_not_with_the_first_state_in_time() -> None:
    link = open_link(LateAxes(held_up=2))
    loop = ControlLoop(load_setup("paper_arm_can").control_task(), link)
    link.spin()
    assert loop.stamp_ns == (TICKS - 1) * GRID.period_ns
    assert loop.tracking.time_s == loop.stamp_ns * 1e-9
