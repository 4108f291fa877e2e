"""The rules by which a new chunk takes over that ship, except the one with a spline."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Annotated, ClassVar, Literal

import numpy as np
from pydantic import Field

from bus_schema.arrays import Matrix, Vector
from bus_schema.configuration import NonNegative, Number
from controller.chunks.answer import Answer
from controller.chunks.merge import ChunkMerge, ChunkTiming, MergeSettings, blended, ensemble

_MOST_CHUNKS = 1000


class Replace(ChunkMerge):
    """The new chunk at once."""

    def merged(self, old: Answer, new: Answer, now_s: float) -> Answer:  # noqa: ARG002
        return new


class ReplaceSettings(MergeSettings):
    """The new chunk acts at once."""

    needs_by_time: ClassVar[bool] = False

    def build(self, timing: ChunkTiming) -> Replace:  # noqa: ARG002
        return Replace()


class Synchronous(Replace):
    """Each chunk acts to its end; then the arm waits for the next, which acts from its begin."""

    waits = True

    def merged(self, old: Answer, new: Answer, now_s: float) -> Answer:  # noqa: ARG002
        return replace(new, starts_s=now_s)


class SynchronousSettings(MergeSettings):
    """The arm waits for each answer."""

    def build(self, timing: ChunkTiming) -> Synchronous:  # noqa: ARG002
        return Synchronous()


class Weighted(ChunkMerge):
    """Mean of old and new where both have rows.

    Args:
        new_weight: share of the new chunk.
    """

    def __init__(self, new_weight: float) -> None:
        self._new_weight = new_weight

    def merged(self, old: Answer, new: Answer, now_s: float) -> Answer:
        return blended(old, new, now_s, lambda _row: self._new_weight)


class WeightedSettings(MergeSettings):
    """A mean where old and new chunk overlap.

    Attributes:
        new_weight: share of the new chunk; LeRobot's asynchronous inference has 0.7.
    """

    needs_by_time: ClassVar[bool] = False
    new_weight: Annotated[Number, Field(ge=0, le=1)] = 0.7

    def build(self, timing: ChunkTiming) -> Weighted:  # noqa: ARG002
        return Weighted(self.new_weight)


class TemporalEnsemble(ChunkMerge):
    """Mean of what all chunks say for a time (ACT, Zhao et al. 2023, algorithm 2).

    Args:
        rate: m; a chunk i younger than the oldest has the weight exp(−m i).
    """

    def __init__(self, rate: float) -> None:
        self._rate = rate
        self._chunks: list[Answer] = []

    def merged(self, old: Answer, new: Answer, now_s: float) -> Answer:
        known = self._chunks or [old]
        older = [each for each in known if each.has_row_at(now_s)]
        self._chunks = [*older[-_MOST_CHUNKS:], new]
        torques, targets = new.torques.copy(), new.targets.copy()
        for row in range(new.row_at(now_s), new.rows):
            time_s = new.time_of(row)
            older = [each for each in self._chunks[:-1] if each.has_row_at(time_s)]
            if row < len(targets):
                rows = [*(each.target_at(time_s) for each in older), targets[row]]
                targets[row] = ensemble(rows, self._rate)
            if row < len(torques):
                rows = [*(each.torque_at(time_s) for each in older), torques[row]]
                torques[row] = ensemble(rows, self._rate)
        return replace(new, torques=torques, targets=targets)

    def reset(self) -> None:
        self._chunks = []


class TemporalEnsembleSettings(MergeSettings):
    """A mean of all chunks that have an action for a time.

    Attributes:
        rate: m of the weights exp(−m i), where i = 0 is the oldest chunk.
    """

    rate: NonNegative = 0.01

    def build(self, timing: ChunkTiming) -> TemporalEnsemble:  # noqa: ARG002
        return TemporalEnsemble(self.rate)


class FrozenPrefix(ChunkMerge):
    """Real-time chunking (Black et al. 2025): the first actions stay, then old ones fade out.

    Args:
        weights: of the old chunk, by action of the new one, shape (horizon,).
        delay_steps: actions that stay.
    """

    def __init__(self, weights: Vector, delay_steps: int) -> None:
        self._weights, self._delay_steps = weights, delay_steps

    def merged(self, old: Answer, new: Answer, now_s: float) -> Answer:
        weights = self._weights
        return blended(
            old, new, now_s, lambda row: 1.0 - weights[row] if row < len(weights) else 1.0
        )

    def guidance(self, old: Answer, asked_s: float) -> tuple[Matrix, Vector, int]:
        times_s = asked_s + old.period_s * np.arange(len(self._weights))
        left = [old.target_at(each) for each in times_s if not old.is_over_at(each)]
        return np.array(left or [old.target_at(asked_s)]), self._weights.copy(), self._delay_steps


class FrozenPrefixSettings(MergeSettings):
    """The actions until an answer can be there stay; after them, old ones fade out.

    Attributes:
        weights: how old actions fade out.
    """

    weights: Literal["linear", "exponential"] = "linear"

    def most_delay_steps(self, timing: ChunkTiming) -> float:
        return min(timing.executed_steps, timing.horizon - timing.executed_steps)

    def problem(self, timing: ChunkTiming) -> str:
        delay, executed, horizon = timing.delay_steps, timing.executed_steps, timing.horizon
        if horizon and delay <= self.most_delay_steps(timing):
            return ""
        return (
            f"delay d, actions between questions s and horizon H must be d ≤ s ≤ H − d, but d is"
            f" {delay}, s is {executed} and H is {horizon or 'not set'}"
        )

    def build(self, timing: ChunkTiming) -> FrozenPrefix:
        delay, fading = timing.delay_steps, timing.horizon - timing.executed_steps
        weights = np.zeros(timing.horizon)
        weights[:delay] = 1.0
        soft = np.linspace(1.0, 0.0, fading - delay + 2)[1:-1]
        if self.weights == "exponential":
            soft = np.array([w * (math.exp(w) - 1.0) / (math.e - 1.0) for w in soft])
        weights[delay:fading] = soft
        return FrozenPrefix(weights, delay)
