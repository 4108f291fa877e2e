"""The protocol of robot interfaces."""

from __future__ import annotations

from typing import NamedTuple, Protocol

import numpy as np

from bus_schema.arrays import Matrix, Vector


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


class Reflexes:
    """Reflexes of a robot's own controller: the first one stops it, and stays.

    Attributes:
        reflex: why the robot has stopped; None while it moves.
    """

    reflex: Reflex | None = None

    def stop(self, kind: str, words: str, joint: int = -1) -> None:
        """Note a reflex, unless the robot has stopped already."""
        if self.reflex is None:
            self.reflex = Reflex(kind, joint, words)


class Integrator:
    """Positions and velocities of joints that a robot accelerates.

    Args:
        position_rad: of the joints, at rest, shape (joints,).

    Attributes:
        position_rad: now.
        velocity_rad_s: now.
    """

    def __init__(self, position_rad: Vector) -> None:
        self.position_rad = position_rad.copy()
        self.velocity_rad_s: Vector = np.zeros(position_rad.size)

    def step(self, change_rad_s: Vector, period_s: float) -> Motion:
        """Return the motion of a cycle in which velocities change steadily by so much."""
        position, velocity = self.position_rad, self.velocity_rad_s
        self.position_rad = position + period_s * (velocity + 0.5 * change_rad_s)
        self.velocity_rad_s = velocity + change_rad_s
        return Motion(position, velocity, change_rad_s / period_s)


class RobotInterface(Protocol):
    """A robot's own controller: one instance for each run.

    Attributes:
        reflex: why the robot has stopped; None while it moves.
    """

    reflex: Reflex | None

    def start(self, position_rad: Vector) -> None:
        """Begin at rest at a position, shape (joints,)."""

    def step(self, target: Matrix | None, measured: Matrix) -> Motion | Vector:
        """Return the motion, or the torque in N m, from this cycle on.

        Args:
            target: newest position, rad, and velocity, rad/s, as rows, shape (2, joints), if one
                has arrived since the last cycle; None otherwise. For robots that take torques, the
                torque as its only row.
            measured: positions and velocities of the joints, likewise.
        """
