"""The controller's side over CAN brings drives to rest: which drives it awaits, how long."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from bus_schema.arrays import Vector
from bus_schema.can.link import CanControllerLink, CanRun
from bus_schema.can.master import DriveError
from bus_schema.link.can_configuration import CanConfiguration
from bus_schema.link.configuration import LinkConfiguration
from bus_schema.link.in_process import InProcessBus, InProcessNode
from bus_schema.link.interface import never
from bus_schema.messages.topics import Role
from bus_schema.runtime.clock import TickGrid, VirtualClock

POLL_S = 0.05
ANSWER_TIMEOUT_S = 40 * POLL_S
GRID = TickGrid(500.0, 1)
STOP_TICKS = 500
"""A second: the longest that a stop takes."""


class Bus:
    """A bus without other nodes."""

    def close(self) -> None:
        pass


class Master:
    """A master whose drives never answer.

    Args:
        failure: what it reads at once of a drive; None for nothing.

    Attributes:
        waits_s: how long it was to wait for answers, each time that it did.
        torques: how often it sent torques.
        has_left: whether it has left the drives.
    """

    def __init__(self, failure: DriveError | None = None) -> None:
        self._failure = failure
        self._is_stopping = self._has_given_up = False
        self.waits_s: list[float] = []
        self.torques = 0
        self.has_left = False

    is_disturbed = False
    emergencies: tuple[str, ...] = ()

    def enable(self, timeout_s: float, is_stop_requested: Callable[[], bool]) -> bool:
        return True

    def skip_late(self) -> None:
        pass

    def sample(self, now_ns: int) -> None:
        pass

    def read(self, timeout_s: float, position: Vector, velocity: Vector) -> bool:
        if self._failure is not None and not self._is_stopping:
            raise self._failure
        if not self._has_given_up:
            self.waits_s.append(timeout_s)
        return self._has_given_up

    def strangers(self) -> str:
        return "another master is on this bus: it sent SYNC (1)" * self.is_disturbed

    def missing(self) -> str:
        return "1"

    def command(self, torque_nm: Vector) -> None:
        self.torques += 1

    def begin_stop(self) -> None:
        self._is_stopping = True

    def give_up(self) -> None:
        self._has_given_up = True

    def is_stopped(self) -> bool:
        return self._has_given_up

    def leave(self) -> None:
        self.has_left = True


def spin(master, *, lockstep=True, is_stop_requested=never):
    can = CanConfiguration(answer_timeout_s=ANSWER_TIMEOUT_S)
    run = CanRun(("joint",), LinkConfiguration(kind="can", can=can), GRID, 10, lockstep)
    clock = VirtualClock()
    telemetry = InProcessNode(InProcessBus(clock), Role.CONTROLLER)
    CanControllerLink(run, master, Bus(), clock, telemetry).spin(is_stop_requested)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("failure", "words"),
    [
        (None, "no answer from drive 1 within 2 s"),
        (DriveError("drive 2 has failed"), "drive 2 has failed"),
    ],
    ids=["alone", "when another fails"],
)
def test_silent_drive_is_waited_for_once(failure: DriveError | None, words: str) -> None:
    master = Master(failure)
    with pytest.raises(DriveError, match=words):
        spin(master)
    assert master.waits_s == [POLL_S] * 40
    assert master.has_left


def test_fault_names_other_masters_on_the_bus() -> None:
    master = Master(DriveError("drive 1: fault"))
    master.is_disturbed = True
    with pytest.raises(DriveError, match=r"^drive 1: fault; another master is on this bus"):
        spin(master)


def test_stop_request_waits_a_second_for_silent_drives() -> None:
    master = Master()
    spin(master, is_stop_requested=lambda: bool(master.waits_s))
    assert master.waits_s == [POLL_S] * (1 + 20)
    assert master.has_left


def test_in_real_time_torques_go_on_in_every_tick_until_the_stop_is_over() -> None:
    master = Master(DriveError("drive 2 has failed"))
    with pytest.raises(DriveError, match="drive 2 has failed"):
        spin(master, lockstep=False)
    assert max(master.waits_s) * 1e9 < GRID.period_ns
    assert master.torques == STOP_TICKS
    assert master.has_left
