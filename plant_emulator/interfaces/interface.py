"""The protocol of robot interfaces."""

from __future__ import annotations

import math
from typing import NamedTuple, Protocol

from bus_schema.arrays import Matrix, Vector

_ROUNDING_S = 1e-9


class Motion(NamedTuple):
    """Motion that a robot's controller asks of its drives, from the start of a cycle on.

    Attributes:
        position_rad: shape (joints,).
        velocity_rad_s: likewise.
        acceleration_rad_s2: likewise.
    """

    position_rad: Vector
    velocity_rad_s: Vector
    acceleration_rad_s2: Vector


class FreeTorque(NamedTuple):
    """Torque beside that of gravity, which the robot's controller adds.

    Attributes:
        torque_nm: shape (joints,).
    """

    torque_nm: Vector


class Reflex(NamedTuple):
    """A stop that a robot's own controller decides.

    Attributes:
        kind: its name, as the robot's maker calls it.
        joint: place of the joint that caused it; -1 for none.
        words: cause, in a few words.
    """

    kind: str
    joint: int
    words: str


class Stoppable:
    """Base of robots that may decide to stop.

    Attributes:
        reflex: why the robot has stopped, the first cause; None while it moves.
    """

    reflex: Reflex | None = None

    def stop(self, kind: str, joint: int, words: str) -> None:
        """Note a reflex, unless an earlier one has stopped the robot."""
        if self.reflex is None:
            self.reflex = Reflex(kind, joint, words)


class LostCount:
    """Count of targets in a row that were late or lost.

    Args:
        most: so many are too many.

    Attributes:
        lost: how many there are now.
    """

    def __init__(self, most: int) -> None:
        self._most, self.lost = most, 0

    @classmethod
    def until(cls, timeout_s: float, period_s: float) -> LostCount:
        """Return a count of cycles without a target until a time-out."""
        return cls(math.ceil((timeout_s - _ROUNDING_S) / period_s))

    def start(self) -> None:
        """Begin with none."""
        self.lost = 0

    def is_over(self, *, arrived: bool) -> bool:
        """Note a cycle with or without a target; return whether too many were lost."""
        self.lost = 0 if arrived else self.lost + 1
        return self.lost >= self._most


class RobotInterface(Protocol):
    """A robot's own controller: one instance for each run.

    Attributes:
        reflex: why the robot has stopped; None while it moves.
    """

    reflex: Reflex | None

    def start(self, position_rad: Vector) -> None:
        """Begin at rest at a position, shape (joints,)."""

    def step(self, target: Matrix | None, measured: Matrix) -> Motion | FreeTorque | Vector:
        """Return the motion, or the torque in N m, from this cycle on.

        Args:
            target: newest position, rad, and velocity, rad/s, as rows, shape (2, joints), if one
                has arrived since the last cycle; None otherwise. For robots that take torques, the
                torque as its only row.
            measured: positions and velocities of the joints, likewise.
        """
