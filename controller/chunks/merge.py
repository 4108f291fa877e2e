"""Base of the rules by which a new answer takes over from the one in force."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from bus_schema.arrays import Matrix, Vector
from bus_schema.configuration import StrictModel
from controller.chunks.answer import Answer


@dataclass(frozen=True)
class ChunkTiming:
    """Lengths that a rule knows of its chunks, and limits of the arm.

    Attributes:
        period_s: between two actions.
        tick_s: period of the control loop.
        horizon: actions of a chunk; 0 if the law chooses it.
        delay_steps: actions that may pass until an answer is there.
        executed_steps: actions from one question to the next.
        velocities_rad_s: largest speeds of the joints, shape (joints,).
    """

    period_s: float
    tick_s: float
    horizon: int
    delay_steps: int
    executed_steps: int
    velocities_rad_s: Vector


class ChunkMerge(ABC):
    """A rule by which a new answer takes over from the one in force."""

    waits: bool = False
    """Whether the law is asked only once nothing is left to send."""

    @abstractmethod
    def merged(self, old: Answer, new: Answer, now_s: float) -> Answer:
        """Return what is in force from now on.

        Args:
            old: what was in force.
            new: the answer, whose first row is meant for the time of its state.
            now_s: time of the state at which it arrived.
        """

    def guidance(self, old: Answer, asked_s: float) -> tuple[Matrix, Vector, int] | None:  # noqa: ARG002
        """Return the guidance for a policy that continues a chunk; None for none.

        Args:
            old: the answer in force.
            asked_s: time of the question.

        Returns:
            Targets in force from then on, shape (rows, 2, joints); their weights, shape (rows,);
            and how many of them will have acted before the answer can.
        """
        return None

    def reset(self) -> None:  # noqa: B027 (most remember nothing)
        """Forget all answers."""


class MergeSettings(StrictModel, ABC):
    """Section of a merge in ``controller.chunks``."""

    needs_by_time: ClassVar[bool] = True
    """Whether rows must be meant for the time of their state."""

    def most_delay_steps(self, timing: ChunkTiming) -> float:  # noqa: ARG002
        """Return the largest number of actions that may pass until an answer is there."""
        return math.inf

    def problem(self, timing: ChunkTiming) -> str:  # noqa: ARG002
        """Return why a merge cannot work with these lengths; empty if it can."""
        return ""

    @abstractmethod
    def build(self, timing: ChunkTiming) -> ChunkMerge:
        """Return a new merge."""


def blended(old: Answer, new: Answer, now_s: float, new_share: Callable[[int], float]) -> Answer:
    """Return an answer whose rows from now on lie between two answers, while both have rows.

    Args:
        old: what was in force; it is read at the times of the new rows.
        new: the new answer.
        now_s: rows before the one for this time stay as they are.
        new_share: weight of the new answer in a row of this number.
    """
    torques, targets = new.torques.copy(), new.targets.copy()
    for row in range(max(0, new.row_at(now_s)), new.rows):
        time_s = new.time_of(row)
        if not old.has_row_at(time_s):
            break
        share = new_share(row)
        if row < len(targets):
            targets[row] = between(old.target_at(time_s), targets[row], share)
        if row < len(torques):
            torques[row] = between(old.torque_at(time_s), torques[row], share)
    return replace(new, torques=torques, targets=targets)


def between(old: Matrix, new: Matrix, share: float) -> Matrix:
    """Return old + share (new − old): equal values stay, to the bit; a share of 1 is the new."""
    return new if share == 1.0 else old + share * (new - old)


def ensemble(rows: list[Matrix], rate: float) -> Matrix:
    """Return the mean of rows with weights exp(−rate i), i = 0 for the first.

    It is the first plus a mean of differences, so that equal rows stay, to the bit.
    """
    weights = [math.exp(-rate * place) for place in range(len(rows))]
    change = np.zeros_like(rows[0])
    for weight, row in zip(weights, rows, strict=True):
        change += weight * (row - rows[0])
    mean: Matrix = rows[0] + change / math.fsum(weights)
    return mean
