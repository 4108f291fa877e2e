"""In real time: an answer that came too late for its tick is never taken for that of another."""

from __future__ import annotations

import math
import struct
from collections.abc import Sequence

from bus_schema.can.cansimple_codec import GET_ENCODER_ESTIMATES, HEARTBEAT, CanSimpleCodec
from bus_schema.can.cansimple_master import CanSimpleMaster
from bus_schema.can.frame import CanFrame
from bus_schema.can.link import CanControllerLink, CanRun
from bus_schema.link.can_configuration import CanConfiguration
from bus_schema.link.configuration import LinkConfiguration
from bus_schema.link.in_process import InProcessBus, InProcessNode
from bus_schema.messages.layout import Record
from bus_schema.messages.topics import JOINT_COMMANDS, JOINT_STATES, Role, layout
from bus_schema.runtime.clock import TickGrid, VirtualClock

NODE = 1
GRID = TickGrid(500.0, 1)
TICKS = 6
CLOSED_LOOP = 8


class LateAxis:
    """A bus with one axis that is held up for the first few requests, then answers them all.

    The position it answers with is the number of the request, in rad.

    Args:
        held_up: how many requests it only answers with the next one after them.
    """

    def __init__(self, held_up: int) -> None:
        self._held_up = held_up
        self._asked = 0
        self._state = 1
        self._owed: list[CanFrame] = []
        self._sent: list[CanFrame] = []

    def send_all(self, frames: Sequence[CanFrame]) -> None:
        for frame in frames:
            command = frame.identifier & 0x1F
            if frame.is_remote and command == GET_ENCODER_ESTIMATES:
                turns = self._asked / (2.0 * math.pi)
                self._owed.append(CanFrame(frame.identifier, struct.pack("<ff", turns, 0.0)))
                self._asked += 1
                if self._asked > self._held_up:
                    self._sent += self._owed
                    self._owed = []
            elif frame.is_remote and command == HEARTBEAT:
                beat = struct.pack("<IBB", 0, self._state, 0) + bytes(2)
                self._sent.append(CanFrame(frame.identifier, beat))
            elif command == 0x07:
                (self._state,) = struct.unpack("<I", frame.data)

    def receive(self, timeout_s: float) -> CanFrame | None:
        return self._sent.pop(0) if self._sent else None

    def close(self) -> None:
        pass


def positions_by_tick(bus: LateAxis) -> dict[int, int]:
    """What the controller's link hands out as the position at each tick."""
    can = CanConfiguration(node_ids=[NODE])
    run = CanRun(("joint",), LinkConfiguration(kind="can", can=can), GRID, TICKS, lockstep=False)
    master = CanSimpleMaster(bus, can, (NODE,), CanSimpleCodec((NODE,)))  # type: ignore[arg-type]
    clock = VirtualClock()
    telemetry = InProcessNode(InProcessBus(clock), Role.CONTROLLER)
    link = CanControllerLink(run, master, bus, clock, telemetry)  # type: ignore[arg-type]
    state = Record(layout(JOINT_STATES, run.joint_names))
    command = layout(JOINT_COMMANDS, run.joint_names).template
    found: dict[int, int] = {}

    def take(payload: bytes, _sender: bytes | None) -> None:
        layout(JOINT_STATES, run.joint_names).decode(payload, state)
        found[state.stamp_ns // GRID.period_ns] = round(float(state.fields["position"][0]))
        link.publish(JOINT_COMMANDS, command)

    link.serve(take)
    link.spin()
    return found


def test_answers_in_time_are_those_of_their_ticks() -> None:
    assert positions_by_tick(LateAxis(0)) == {tick: tick for tick in range(TICKS)}


def test_states_that_were_late_once_do_not_stay_late() -> None:
    found = positions_by_tick(LateAxis(2))
    assert {tick: found[tick] for tick in range(3, TICKS)} == {3: 3, 4: 4, 5: 5}
    assert set(found) == {2, 3, 4, 5}
