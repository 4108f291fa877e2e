"""The dead time of actuators: commands wait for a whole number of physics substeps."""

from __future__ import annotations

from collections import deque
from typing import NamedTuple

from bus_schema.arrays import Matrix, Vector

NEVER = 2**62
"""Number of a substep that no run has."""


class DriveCommand(NamedTuple):
    """What the drives of an arm are told.

    Attributes:
        torque_nm: shape (joints,).
        target: position, rad, and velocity, rad/s, as rows, shape (2, joints); None for none.
        stamp_ns: stamp of the state that the command answers.
    """

    torque_nm: Vector
    target: Matrix | None
    stamp_ns: int


class DelayLine:
    """Commands on their way through the actuators, each in the order of its arrival.

    Args:
        substeps: the dead time; 0 for none.

    Attributes:
        substeps: as above.
    """

    def __init__(self, substeps: int) -> None:
        self.substeps = substeps
        self._next = 0
        self._waiting: deque[tuple[int, DriveCommand]] = deque()

    @property
    def next_due(self) -> int:
        """Number of the substep at which the next command acts."""
        return self._waiting[0][0] if self._waiting else NEVER

    def put(self, command: DriveCommand) -> None:
        """Add a command that arrives before the next substep."""
        self._waiting.append((self._next + self.substeps, command))

    def take_due(self, number: int) -> list[DriveCommand]:
        """Return the commands that act from a substep on, which is the next one."""
        self._next, due = number, []
        while self.next_due <= number:
            due.append(self._waiting.popleft()[1])
        return due

    def pass_by(self, end: int) -> None:
        """Note that all substeps before this one are computed."""
        self._next = end

    def clear(self) -> None:
        """Forget the commands that wait."""
        self._waiting.clear()
