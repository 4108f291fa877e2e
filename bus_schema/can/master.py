"""What a controller may ask of the master of a CAN bus with motor drives."""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol

from bus_schema.arrays import Vector
from bus_schema.can.frame import BUS_OFF, CanFrame
from bus_schema.errors import BusError


class DriveError(BusError):
    """A drive is not what it should be, or no longer does what it must; the message says which."""


class CanMaster(Protocol):
    """The master of one protocol; joints are counted from 0."""

    def enable(self, timeout_s: float, is_stop_requested: Callable[[], bool]) -> bool:
        """Take all drives from power-on to where they follow torques; false if asked to stop.

        Args:
            timeout_s: how long to wait for the drives to turn up, wall time.
            is_stop_requested: looked at while waiting.

        Raises:
            DriveError: a drive does not come, is another than expected, or does not follow.
        """
        ...

    def sample(self, now_ns: int) -> None:
        """Have all drives sample their joints; `now_ns` is the time of the run."""
        ...

    def read(self, timeout_s: float, position: Vector, velocity: Vector) -> bool:
        """Write what the drives answer, shape (joints,); false if some do not within `timeout_s`.

        Raises:
            DriveError: a drive reports a fault, stopped following, or fell silent.
        """
        ...

    def missing(self) -> str:
        """Addresses of the drives that have not answered yet, in words."""
        ...

    def command(self, torque_nm: Vector) -> None:
        """Send torques, shape (joints,)."""
        ...

    def begin_stop(self) -> None:
        """From now on drives are to come to rest; torques are no longer sent, faults expected."""
        ...

    def is_stopped(self) -> bool:
        """Whether no drive that can be heard has its power stage on any longer."""
        ...

    def leave(self) -> None:
        """Say goodbye to the drives."""
        ...


class Roll:
    """Which drives have answered since they were asked, and which will no longer.

    Args:
        node_ids: addresses of the drives.

    Attributes:
        silent: joints of drives that are no longer waited for.
    """

    def __init__(self, node_ids: tuple[int, ...]) -> None:
        self._node_ids = node_ids
        self._missing: set[int] = set()
        self.silent: set[int] = set()

    @property
    def is_complete(self) -> bool:
        return not self._missing

    @property
    def missing(self) -> str:
        """Addresses of those that have not answered yet."""
        return ", ".join(str(self._node_ids[joint]) for joint in sorted(self._missing))

    def call(self) -> None:
        """All were asked."""
        self._missing = set(range(len(self._node_ids))) - self.silent

    def answered(self, joint: int) -> None:
        """One has answered."""
        self._missing.discard(joint)

    def give_up(self) -> None:
        """Those that have not answered are not waited for any longer."""
        self.silent |= self._missing
        self._missing = set()


def bus_fault(frame: CanFrame) -> str | None:
    """What an error frame of the local controller says is wrong with the bus, if anything."""
    return "the CAN controller is bus-off" if frame.identifier & BUS_OFF else None
