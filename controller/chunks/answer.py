"""Answer of a law: rows for the next ticks or actions."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from bus_schema.arrays import Matrix, Vector

BetweenAnswers = Literal["hold", "linear"]
NEAR = 1e-6
"""Part of a period by which times may differ, as they are floating-point numbers."""


@dataclass(frozen=True)
class Holding:
    """Behaviour of targets between two rows, and after the last one.

    Attributes:
        between: they stay, or go on at their velocity.
        keeps_velocity: held targets keep their velocity, as for a robot that takes velocities.
    """

    between: BetweenAnswers = "hold"
    keeps_velocity: bool = False


@dataclass(frozen=True)
class Answer:
    """Answer of a law.

    Attributes:
        asked_s: time of the state that it answers.
        starts_s: time for which its first row is meant.
        period_s: between two rows.
        torques: shape (rows, joints), N m; a single row is held.
        targets: positions and velocities of shape (rows, 2, joints), rad and rad/s.
        holding: what its targets do between rows.
    """

    asked_s: float
    starts_s: float
    period_s: float
    torques: Matrix
    targets: Matrix
    holding: Holding

    @property
    def rows(self) -> int:
        """Number of rows of the longer one, torques or targets."""
        return max(len(self.torques), len(self.targets))

    @property
    def end_s(self) -> float:
        """Time at which its last row is over."""
        return self.starts_s + self.rows * self.period_s

    def row_at(self, time_s: float) -> int:
        """Return the number of the row for a time; those past the last do not exist."""
        return int((time_s - self.starts_s) / self.period_s + NEAR)

    def time_of(self, row: int) -> float:
        """Return the time at which a row begins, s."""
        return self.starts_s + row * self.period_s

    def has_row_at(self, time_s: float) -> bool:
        """Whether a row is meant for a time; a single row goes on acting, but is meant for one."""
        return self.row_at(time_s) < self.rows

    def is_over_at(self, time_s: float) -> bool:
        """Whether torques or targets of several rows have none left for a time."""
        row = self.row_at(time_s)
        return any(1 < each <= row for each in (len(self.torques), len(self.targets)))

    def torque_at(self, time_s: float) -> Vector:
        """Return the torques in force at a time, N m, shape (joints,)."""
        row: Vector = self.torques[min(self.row_at(time_s), len(self.torques) - 1)]
        return row

    def target_at(self, time_s: float) -> Matrix:
        """Return the target in force at a time, shape (2, joints)."""
        last = len(self.targets) - 1
        row = min(self.row_at(time_s), last)
        target: Matrix = self.targets[row].copy()
        if self.holding.between == "linear":
            target[0] += (time_s - self.starts_s - row * self.period_s) * target[1]
        elif row == last and not self.holding.keeps_velocity:
            target[1] = 0.0
        return target

    def acceleration_at(self, time_s: float) -> Vector:
        """Return the change of the velocities from a row to the next, rad/s², shape (joints,).

        It is zero from the last row on.
        """
        row = self.row_at(time_s)
        if row + 1 >= len(self.targets):
            return np.zeros(self.targets.shape[2])
        change: Vector = (self.targets[row + 1, 1] - self.targets[row, 1]) / self.period_s
        return change


class AnswerShapeError(ValueError):
    """A law's answer has another shape than its scenario needs, as each of its answers will."""


def checked_rows(what: str, answer: object, shape: tuple[int, ...]) -> Matrix:
    """Return a copy of a law's answer, as one row or more.

    Args:
        what: it is, for the error message.
        answer: from the law.
        shape: of a row.

    Raises:
        AnswerShapeError: the answer has another shape.
        ValueError: an entry is not finite; the first one is named.
    """
    rows: Matrix = np.array(answer, dtype=np.float64)
    given = rows.shape
    if given == shape:
        rows = rows[np.newaxis]
    if rows.shape[1:] != shape or not rows.size:
        allowed = f"must be {shape}, or {shape} for each row"
        raise AnswerShapeError(f"{what} have shape {given}: {allowed}")
    if not np.isfinite(rows).all():
        place = tuple(int(each) for each in np.argwhere(~np.isfinite(rows))[0])
        raise ValueError(f"{what}{list(place)} = {rows[place]}: must be finite")
    return rows
